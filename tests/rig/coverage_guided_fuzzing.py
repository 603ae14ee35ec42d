"""Coverage-guided inputs for every parser: python -m tests.rig.coverage_guided_fuzzing PROTOCOL|requests COUNT (needs
the package atheris).
"""

import sys

import atheris

with atheris.instrument_imports(
    include=[
        "rig.driving.protocols",
        "rig.driving.request_and_answer_exchange_with_controller",
        "rig.driving.emulators.native_strut_protocol",
        "rig.driving.emulators.emulator_base_true_command_log_and_user_emulators",
    ]
):
    from tests.rig.random_bytes import answers, requests


def main():
    """Feed what the fuzzer makes to a parser; a crash, a hang or a move ends it with a report."""
    protocol, count = sys.argv[1], sys.argv[2]
    feed = requests if protocol == "requests" else lambda data: answers(protocol, data)
    atheris.Setup([sys.argv[0], f"-runs={count}", "-max_len=400", "-timeout=20", "-print_final_stats=1"], feed)
    atheris.Fuzz()


main()
