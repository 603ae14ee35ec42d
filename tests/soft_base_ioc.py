"""A soft IOC of EPICS base, by pythonSoftIOC: RIG:m1 .. RIG:m6, analog outputs in mm that RIG:r1 .. RIG:r6 follow.

EPICS base has no motor records. Run as a program it takes the TCP port.
"""

import os
import sys
import time


def main():
    os.environ |= {"EPICS_CA_SERVER_PORT": sys.argv[1], "EPICS_CAS_INTF_ADDR_LIST": "127.0.0.1"}
    from softioc import asyncio_dispatcher, builder, softioc

    builder.SetDeviceName("RIG")
    for k in range(1, 7):
        read = builder.aIn(f"r{k}", initial_value=0.0, EGU="mm", PREC=6)
        builder.aOut(f"m{k}", initial_value=0.5 * k, EGU="mm", PREC=6, on_update=read.set)
    builder.LoadDatabase()
    softioc.iocInit(asyncio_dispatcher.AsyncioDispatcher())
    print("ready", flush=True)
    while True:
        time.sleep(1)


if __name__ == "__main__":
    main()
