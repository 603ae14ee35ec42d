"""Random bytes at every parser: no crash, no hang, no move. What hypothesis makes is helped by pieces of true
conversations.
"""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.rig.random_bytes import MAKE, answers, requests

PIECES = [
    b"ok\r\n",
    b"error:15\r\n",
    b"ALARM:1\r\n",
    b"<Idle|MPos:1.000,2.000,3.000,4.000,5.000,6.000|Bf:100,1023|FS:0,0|Pn:M>\r\n",
    b"<Run|WPos:1.0,2.0>",
    b"[GC:G1 G21 G90 G94 F0]\r\n",
    b"[OPT:V,15,64]\r\n",
    b"$13=1\r\n",
    b"1=1.0 \n2=1.0 \n3=1.0 \n4=1.0 \n5=1.0 \n6=1.0\n",
    b"0\n",
    b"-1024\n",
    b"3F\n",
    b"\x1e0 \n",
    b"PI, a, b, c\n",
    b"1 \n2 \n3 \n4 \n5 \n6\n",
    b"HELLO ACK EMCNETSVR 1.1\r\n",
    b"SET MDI NAK\n\r",
    b"JOINT_POS 1.0 2.0\r\n",
    b"ERROR x\r\n",
    b"PROGRAM_STATUS RUNNING\r\n",
    b"<1 OK struts/1 axes=6 boot=0EA93B36 line=128 pc*9496\n",
    b"<- NAK*8B54\n",
    b"\x00",
    b"\xff",
    b"\n",
]
data = st.lists(st.one_of(st.sampled_from(PIECES), st.binary(max_size=40)), max_size=8).map(b"".join)
quick = settings(
    max_examples=60, derandomize=True, database=None, deadline=None, suppress_health_check=list(HealthCheck)
)


@pytest.mark.parametrize("protocol", MAKE)
def test_any_answer(protocol):
    quick(given(st.integers(0, 255), data)(lambda which, text: answers(protocol, bytes([which]) + text)))()


def test_any_request():
    quick(given(data)(requests))()


@pytest.mark.parametrize("which, answer", [(5, b"ALARM:1\xb2\r\n"), (3, b"ALARM:\xb3\r\n")])
def test_a_superscript_is_no_number(which, answer):
    answers("grblhal", bytes([which]) + answer)


@pytest.mark.slow
@pytest.mark.parametrize("protocol", [*MAKE, "requests"])
def test_a_million_random_inputs(protocol):
    rng = np.random.default_rng(0)
    for _ in range(1_000_000):
        pick = rng.integers(0, len(PIECES), rng.integers(0, 5))
        text = b"".join(PIECES[i] for i in pick)
        cut = int(rng.integers(0, len(text) + 1))
        text = text[:cut] + rng.bytes(int(rng.integers(0, 20))) + text[cut + int(rng.integers(0, 3)) :]
        requests(text) if protocol == "requests" else answers(protocol, bytes([int(rng.integers(256))]) + text)
