"""The built-in vehicle answers a scripted ground station as ArduCopter did (tests/data/conversation.json), but for what is listed."""

import importlib.util
import json
import re
from pathlib import Path

import pytest

from flighttest.sim import InProcess, SimOptions
from flighttest.sim.sitl.launcher import SitlOptions, launch

# Said by the real firmware about things the built-in vehicle does not have, or at moments of its own; see docs/built_in_vehicle.md.
ASIDE = re.compile(
    r"STATUSTEXT \d (EKF3|AHRS|GPS|PreArm|SIM Hit|Field Elevation|Barometer|ArduPilot Ready|RC7|[0-9a-f]{32}$)"
    r"|PARAM_VALUE (STAT_|MOT_THST_HOVER)"
)
# step: what the built-in vehicle sends, what ArduCopter 4.7.0-dev sends instead
DIFFERENCES = {
    "parameters": ("PARAM_VALUE ATC_ANGLE_MAX 30 type 9 index 65535", "PARAM_VALUE ANGLE_MAX 3000 type 4 index 65535"),
    "parameter list": (
        "STATUSTEXT 6 ArduCopter V4.7.0-dev (simulate)",
        "STATUSTEXT 6 ArduCopter V4.7.0-dev (2598e9d4)",
    ),
    "odd commands on the ground": (
        "COMMAND_ACK 176 result 4 to 250/190|STATUSTEXT 4 No such mode 18",
        "COMMAND_ACK 176 result 0 to 250/190|HEARTBEAT mode 18 disarmed",
    ),
    "landing": ("LOG_ENTRY num_logs 0", "LOG_ENTRY num_logs 1"),
}
# A HEARTBEAT, sent ten times a second, falls on either side of what happens beside it; fences are left with a word of their own.
ANYWHERE = ("HEARTBEAT", "EXTENDED_SYS_STATE")


class InThisProcess:
    """The built-in vehicle without a socket."""

    def __init__(self) -> None:
        self.io = InProcess(SimOptions(seed=3))

    def send(self, data: bytes) -> None:
        self.io.send(data)

    def pump(self) -> bytes:
        self.io.advance(0.01)
        return self.io.receive()


@pytest.fixture(scope="module")
def talk():
    spec = importlib.util.spec_from_file_location("conversation", Path(__file__).with_name("conversation.py"))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def real(repository):
    return json.loads((repository / "tests" / "data" / "conversation.json").read_text())


@pytest.fixture(scope="module")
def built_in(talk):
    return talk.hold(InThisProcess())


def plain(lines: list[str]) -> list[str]:
    """Without what is aside; the words of one answer apart, those that may fall anywhere at the end."""
    apart = [part for line in lines for part in re.split(r"; (?=[A-Z_]+ \d)", line) if not ASIDE.search(part)]
    apart = [re.sub(r": STATUSTEXT \d GPS.*", ":", part) for part in apart]
    kept = [part for part in apart if not part.startswith(ANYWHERE)]
    return [*kept, *sorted({part for part in apart if part.startswith(ANYWHERE)})]


def with_ours(lines: list[str], ours: list[str], theirs: list[str]) -> list[str]:
    """The real answers with one stretch put as the built-in vehicle puts it."""
    for k in range(len(lines) - len(theirs) + 1):
        if lines[k : k + len(theirs)] == theirs:
            return [*lines[:k], *ours, *lines[k + len(theirs) :]]
    raise AssertionError(f"{theirs} was not recorded")


@pytest.mark.slow
def test_the_same_questions_were_asked(built_in, real):
    assert list(built_in) == list(real)
    assert real["unasked"] == ["HEARTBEAT"]
    assert set(built_in["unasked"]) == {"HEARTBEAT", "STATUSTEXT"}, "boot takes the built-in vehicle less time"


@pytest.mark.parametrize(
    "step",
    [
        "first heartbeat", "message intervals", "parameters", "parameter list", "time, logs, mission, ping",
        "odd commands on the ground", "SET_MODE", "arming in GUIDED_NOGPS", "disarming", "arming in GUIDED", "take-off",
        "commands in the air", "attitude targets", "fence", "landing",
    ],
)  # fmt: skip
def test_it_answers_as_arducopter_does(built_in, real, step):
    said = real[step]
    if step in DIFFERENCES:
        mine, others = (words.split("|") for words in DIFFERENCES[step])
        assert set(mine) <= set(built_in[step]), "no longer a difference: take it off the list"
        said = with_ours(said, mine, others)
    ours, theirs = plain(built_in[step]), plain(said)
    if step == "disarming":  # the real one's next HEARTBEAT came after the last word of this step
        ours.remove("HEARTBEAT mode 20 disarmed")
    if step == "landing":  # flown with the fence just switched off: the real one still takes LAND for a recovery
        theirs.remove("STATUSTEXT 6 Manual recovery started")
    assert ours == theirs


def test_what_differs_is_said_to_the_reader(repository):
    page = (repository / "docs" / "built_in_vehicle.md").read_text()
    for words in ("ATC_ANGLE_MAX", "THROW", "LOG_BACKEND_TYPE", "STAT_RUNTIME", "Manual recovery", "SIM_LOCKSTEP"):
        assert words in page


@pytest.mark.sitl
def test_the_recorded_answers_are_still_those_of_the_real_firmware(arducopter, talk, real):
    values = {"FENCE_ENABLE": 0.0, "GUID_TIMEOUT": 3.0, "GUID_OPTIONS": 0.0}
    with launch(SitlOptions(airframe="stock", speedup=4.0, parameters=values), wait_s=0.0) as vehicle:
        now = talk.hold(talk.Socket(vehicle.url))
    for step in (
        "parameters",
        "odd commands on the ground",
        "take-off",
        "commands in the air",
        "attitude targets",
        "fence",
    ):
        assert plain(now[step]) == plain(real[step]), step
