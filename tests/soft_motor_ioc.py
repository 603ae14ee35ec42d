"""A soft IOC with six motor records of caproto, in a process of its own: trapezoidal moves, limits, homing and faults.

RIG:m1 .. RIG:m6 in mm, or in other units, as of a pose's coordinates; RIG:stall and RIG:fault take the number of a
motor that stalls in its next move, or whose driver fails in it; RIG:locked that of one whose VAL new clients may not
write. Run as a program it takes the TCP port, the place at which the motors stand, and their six units.
"""

import asyncio
import os
import sys

from caproto import AccessRights
from caproto.asyncio.server import Context
from caproto.server import PVGroup, pvproperty

TICK = 0.002  # s
LOW, HIGH = -60.0, 60.0  # mm
HOME, HOMING_SPEED = 0.0, 20.0  # mm, mm/s
STALLS, PROBLEM, HOMED = 1 << 6, 1 << 9, 1 << 14


def trapezoid(t, distance, speed, ramp):
    """(mm passed, whether it is over) at t (s) of a way (mm, above 0) at a speed (mm/s), reached within ramp (s)."""
    rate = speed / ramp
    if distance < speed * ramp:  # it never comes to full speed
        ramp = (distance / rate) ** 0.5
        speed = rate * ramp
    whole = distance / speed + ramp
    if t >= whole:
        return distance, True
    if t < ramp:
        return rate * t * t / 2, False
    if t > whole - ramp:
        return distance - rate * (whole - t) ** 2 / 2, False
    return speed * (t - ramp / 2), False


class Motor:
    """What moves behind a record. at : mm; move : (s begun, mm from, mm to, mm/s, s) under way, or None"""

    def __init__(self, group, record, number):
        self.group, self.record, self.number = group, record, number
        self.at, self.move, self.status, self.homing = group.start, None, 0, False

    @property
    def fields(self):
        return self.record.field_inst

    async def ready(self):
        f = self.fields
        for field, value in (
            (f.engineering_units, self.group.units[self.number - 1]),
            (f.user_low_limit, LOW),
            (f.user_high_limit, HIGH),
            (f.velocity, 5.0),
            (f.max_velocity, 300.0),
            (f.seconds_to_velocity, 0.2),
            (f.limit_violation, 0),
            (f.user_readback_value, self.at),
            (f.motor_status, 0),
        ):
            await field.write(value)
        await self.record.write(self.at)
        f.value_write_hook = self.notice
        whole = AccessRights.READ | AccessRights.WRITE
        self.record.check_access = lambda host, user: (
            AccessRights.READ if self.number == self.group.locked.value else whole
        )

    async def notice(self, fields, value):
        """VAL was written."""
        f = self.fields
        beyond = not f.user_low_limit.value <= value <= f.user_high_limit.value
        await f.limit_violation.write(int(beyond))
        if not beyond and f.stop_pause_move_go.value in ("Go", 3):
            await self.go(value, max(f.velocity.value, 1e-3), max(f.seconds_to_velocity.value, 1e-3))

    async def go(self, goal, speed, ramp):
        if self.number == self.group.stall.value:
            await self.group.stall.write(0)
            goal, self.status = (self.at + goal) / 2, self.status | STALLS << 16  # shown at its end
        elif self.number == self.group.fault.value:
            await self.group.fault.write(0)
            goal, self.status = self.at + 0.7 * (goal - self.at), self.status | PROBLEM << 16
        self.move = (asyncio.get_running_loop().time(), self.at, goal, speed, ramp)
        await self.fields.done_moving_to_value.write(0)

    async def tick(self, now):
        f = self.fields
        if f.stop.value:
            await f.stop.write(0)
            self.move = None
            await self.stand(interrupted=True)
        elif f.home_forward.value and not self.homing:
            self.homing, self.status = True, 0
            await self.go(HOME, HOMING_SPEED, 0.05)
        if self.move is None:
            return
        begun, start, goal, speed, ramp = self.move
        passed, over = trapezoid(now - begun, abs(goal - start), speed, ramp) if goal != start else (0.0, True)
        self.at = start + (passed if goal > start else -passed)
        await f.user_readback_value.write(self.at)
        if over:
            self.move = None
            await self.stand()

    async def stand(self, interrupted=False):
        f = self.fields
        late, self.status = self.status >> 16, self.status & 0xFFFF
        if not interrupted:
            self.status |= late
            if self.homing:
                self.status |= HOMED
        self.homing = False
        await f.home_forward.write(0)
        await f.motor_status.write(self.status)
        if interrupted:
            await self.record.write(self.at, verify_value=False)
        await f.user_readback_value.write(self.at)
        await f.done_moving_to_value.write(1)


class Motors(PVGroup):
    m1 = pvproperty(value=0.0, record="motor")
    m2 = pvproperty(value=0.0, record="motor")
    m3 = pvproperty(value=0.0, record="motor")
    m4 = pvproperty(value=0.0, record="motor")
    m5 = pvproperty(value=0.0, record="motor")
    m6 = pvproperty(value=0.0, record="motor")
    stall = pvproperty(value=0)
    fault = pvproperty(value=0)
    locked = pvproperty(value=0)

    start, units = 0.0, ("mm",) * 6

    @stall.startup
    async def stall(self, instance, async_lib):
        motors = [Motor(self, getattr(self, f"m{k}"), k) for k in range(1, 7)]
        for motor in motors:
            await motor.ready()
        print("ready", flush=True)
        while True:
            for motor in motors:
                await motor.tick(asyncio.get_running_loop().time())
            await asyncio.sleep(TICK)


def main():
    os.environ["EPICS_CA_SERVER_PORT"] = sys.argv[1]
    Motors.start, Motors.units = float(sys.argv[2]), sys.argv[3:9]

    async def serve():
        await Context(Motors(prefix="RIG:").pvdb, interfaces=["127.0.0.1"]).run()

    asyncio.run(serve())


if __name__ == "__main__":
    main()
