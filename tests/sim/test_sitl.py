"""Finding, starting and stopping a real ArduPilot SITL. What needs the real one is marked `sitl`."""

import os
import socket
import stat
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from pymavlink import mavutil
from pymavlink.quaternion import Quaternion

from flighttest.errors import InputError, LinkError
from flighttest.identify.models.model_file import ModelFile
from flighttest.physics.model import Model
from flighttest.sim.options import SimOptions
from flighttest.sim.sitl.launcher import (
    AIRFRAMES,
    DOCUMENTATION,
    SitlOptions,
    command,
    find_arducopter,
    free_ports,
    launch,
    sitl_dir,
)
from flighttest.sim.sitl.physics import firmware_parameters, launch_on_physics
from flighttest.twin.firmware import firmware_options
from flighttest.vehicle.load import load_vehicle


def program(path: Path, text: str = "#!/bin/sh\nsleep 60\n") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


class TestFind:
    def test_environment_variable_first(self, tmp_path):
        named, other = program(tmp_path / "mine"), program(tmp_path / "bin" / "arducopter")
        env = {"ARDUCOPTER": str(named), "PATH": str(other.parent), "HOME": str(tmp_path)}
        assert find_arducopter(env) == named.resolve()

    def test_then_path_then_checkouts(self, tmp_path):
        on_path = program(tmp_path / "bin" / "arducopter")
        built = program(tmp_path / "ap" / "build/sitl/bin/arducopter")
        home = program(tmp_path / "ardupilot" / "build/sitl/bin/arducopter")
        env = {"PATH": str(on_path.parent), "ARDUPILOT_HOME": str(tmp_path / "ap"), "HOME": str(tmp_path)}
        assert find_arducopter(env) == on_path.resolve()
        assert find_arducopter({**env, "PATH": "/nowhere"}) == built.resolve()
        assert find_arducopter({"PATH": "/nowhere", "HOME": str(tmp_path)}) == home.resolve()

    def test_a_wrong_name_is_not_passed_over(self, tmp_path):
        on_path = program(tmp_path / "bin" / "arducopter")
        with pytest.raises(LinkError, match="ARDUCOPTER=/not/there"):
            find_arducopter({"ARDUCOPTER": "/not/there", "PATH": str(on_path.parent), "HOME": str(tmp_path)})

    def test_none_points_to_ardupilot(self, tmp_path):
        with pytest.raises(LinkError) as caught:
            find_arducopter({"PATH": "/nowhere", "HOME": str(tmp_path)})
        assert DOCUMENTATION in caught.value.hint


class TestCommand:
    @pytest.mark.parametrize("airframe", AIRFRAMES)
    def test_every_airframe_is_shipped_whole(self, airframe, tmp_path):
        words = command(SitlOptions(airframe=airframe), Path("/x/arducopter"), 17000, tmp_path)
        for path in words[words.index("--defaults") + 1].split(","):
            assert Path(path).is_file()
        frame = AIRFRAMES[airframe].frame
        assert frame is None or (tmp_path / frame).is_file()
        assert load_vehicle(sitl_dir() / f"{airframe}.yaml").firmware == "ardupilot"

    def test_own_values_come_last(self, tmp_path):
        words = command(SitlOptions(parameters={"GUID_TIMEOUT": 1.5}), Path("/x"), 17000, tmp_path)
        extra = words[words.index("--defaults") + 1].split(",")[-1]
        assert Path(extra).read_text() == "GUID_TIMEOUT 1.5\n"

    def test_a_folder_named_from_here_is_found_from_there(self, tmp_path, monkeypatch):
        """The firmware runs in that folder and looked for `sitl/extra.parm` below it: it never answered."""
        monkeypatch.chdir(tmp_path)
        fake = program(tmp_path / "arducopter", '#!/bin/sh\necho "$@" > words\nexec sleep 60\n')
        with launch(SitlOptions(folder=Path("sitl"), parameters={"GUID_TIMEOUT": 1.5}), binary=fake, wait_s=0.0):
            written = tmp_path / "sitl" / "words"
            deadline = time.monotonic() + 10.0
            while not (written.is_file() and written.read_text()) and time.monotonic() < deadline:
                time.sleep(0.01)
            words = written.read_text().split()
        extra = words[words.index("--defaults") + 1].split(",")[-1]
        assert (tmp_path / "sitl" / extra).read_text() == "GUID_TIMEOUT 1.5\n"

    def test_parameter_files_are_what_the_firmware_reads(self):
        for path in sitl_dir().glob("*.parm"):
            for number, line in enumerate(path.read_text().splitlines(), 1):
                if line.strip() and not line.startswith("#"):
                    name, value = line.split()
                    assert name.isupper(), f"{path.name}:{number}"
                    float(value)

    def test_unknown_airframe(self):
        with pytest.raises(InputError, match="balloon"):
            SitlOptions(airframe="balloon")

    def test_ports_in_use_are_passed_over(self):
        with socket.socket() as taken:
            taken.bind(("127.0.0.1", 0))
            taken.listen()
            busy = taken.getsockname()[1]
            with pytest.raises(LinkError, match="ports"):
                free_ports([busy])

    def test_a_port_that_somebody_needs_is_taken_or_the_launch_refused(self, tmp_path):
        fake = program(tmp_path / "arducopter")
        base = free_ports()
        with socket.socket() as taken:
            taken.bind(("127.0.0.1", base + 3))
            taken.listen()
            with pytest.raises(LinkError, match=f"port {base + 3} cannot be used; a SITL at {base} needs"):
                launch(SitlOptions(port=base), binary=fake, wait_s=0.0)
        with pytest.raises(LinkError, match="port 65536 cannot be used"):
            launch(SitlOptions(port=65530), binary=fake, wait_s=0.0)
        with launch(SitlOptions(port=base), binary=fake, wait_s=0.0) as vehicle:
            assert vehicle.url == f"tcp:127.0.0.1:{base}"


class TestProcess:
    def test_a_firmware_without_scripting_is_refused_at_once_where_scripts_are_needed(self, tmp_path):
        script = program(tmp_path / "battery.lua")
        without = program(tmp_path / "arducopter")
        with pytest.raises(LinkError, match="built without scripting"):
            launch(SitlOptions(scripts=(script,)), binary=without, wait_s=0.0)
        having = program(tmp_path / "with", "#!/bin/sh\n# Scripting: started\nexec sleep 60\n")
        launch(SitlOptions(scripts=(script,)), binary=having, wait_s=0.0).stop()

    def test_a_firmware_that_ends_says_what_it_printed(self, tmp_path):
        fake = program(tmp_path / "arducopter", "#!/bin/sh\necho frame file is broken\nexit 3\n")
        with pytest.raises(LinkError, match=r"code 3(.|\n)*frame file is broken"):
            launch(binary=fake, wait_s=10.0)

    def test_a_silent_firmware_times_out_and_is_stopped(self, tmp_path):
        folder = tmp_path / "run"
        fake = program(tmp_path / "arducopter", f"#!/bin/sh\necho $$ > {folder}/pid\nexec sleep 60\n")
        with pytest.raises(LinkError, match="no heartbeat"):
            launch(SitlOptions(folder=folder), binary=fake, wait_s=0.5)
        with pytest.raises(ProcessLookupError):
            os.kill(int((folder / "pid").read_text()), 0)

    def test_a_temporary_folder_goes_away(self, tmp_path):
        fake = program(tmp_path / "arducopter")
        with launch(binary=fake, wait_s=0.0) as vehicle:
            assert vehicle.alive
            folder = vehicle.folder
            assert folder.is_dir()
        assert not vehicle.alive
        assert not folder.exists()


class TestRotorParameters:
    def test_gains_follow_moment_over_inertia(self):
        one = firmware_parameters(SimOptions(airframe="rotor"))
        heavy = firmware_parameters(SimOptions(airframe="rotor", vehicle={"inertia_x_kg_m2": 0.072}))
        assert heavy["ATC_RAT_RLL_P"] == pytest.approx(2.0 * one["ATC_RAT_RLL_P"])
        assert heavy["ATC_RAT_PIT_P"] == one["ATC_RAT_PIT_P"]

    def test_only_the_rotor_airframe(self):
        with pytest.raises(InputError, match="rotor"):
            firmware_parameters(SimOptions(airframe="paper"))


def fly_a_minute(url: str) -> dict[str, float]:
    """Arm, take off to 6 m, half a second at 0.2 rad in GUIDED_NOGPS with bare pymavlink; what was seen."""
    link = mavutil.mavlink_connection(url, source_system=250)
    seen: dict[str, float] = {}

    def take(kind: str, wait_s: float = 10.0):
        found = link.recv_match(type=kind, blocking=True, timeout=wait_s)
        assert found is not None, f"no {kind} in {wait_s} s"
        return found

    def order(number: int, *values: float) -> int:
        link.mav.command_long_send(1, 1, number, 0, *(list(values) + [0.0] * (7 - len(values))))
        while (ack := take("COMMAND_ACK")).command != number:
            pass
        return ack.result

    take("HEARTBEAT")
    for message in (30, 32, 83, 147):
        assert order(511, message, 20000) == 0
    assert order(176, 1, 4) == 0
    for _ in range(20):
        if (result := order(400, 1)) == 0:
            break
        take("HEARTBEAT")
    assert result == 0
    assert order(22, 0, 0, 0, 0, 0, 0, 6) == 0
    for _ in range(2000):
        if take("LOCAL_POSITION_NED").z < -5.5:
            break
    seen["height_m"] = -take("LOCAL_POSITION_NED").z
    target = take("ATTITUDE_TARGET")
    seen["hover_throttle"] = target.thrust
    seen["voltage_v"] = take("BATTERY_STATUS").voltages[0] / 1000.0
    assert order(176, 1, 20) == 0
    yaw = take("ATTITUDE").yaw
    boot = start = take("ATTITUDE").time_boot_ms
    while boot < start + 1000:
        attitude = take("ATTITUDE")
        boot = attitude.time_boot_ms
        link.mav.set_attitude_target_send(boot, 1, 1, 7, list(Quaternion([0.2, 0.0, yaw]).q), 0, 0, 0, target.thrust)
    seen["roll_rad"] = attitude.roll
    link.close()
    return seen


@pytest.mark.sitl
def test_the_real_firmware_flies_the_paper_airframe(arducopter):
    with launch(SitlOptions(airframe="paper", speedup=5), binary=Path(arducopter)) as vehicle:
        seen = fly_a_minute(vehicle.url)
    assert seen["height_m"] > 5.0
    assert seen["roll_rad"] == pytest.approx(0.2, abs=0.04)
    assert seen["hover_throttle"] == pytest.approx(0.16, abs=0.03)  # full pack: below 0.18
    assert 22.0 < seen["voltage_v"] < 25.3


@pytest.mark.sitl
@pytest.mark.skipif(sys.platform == "win32", reason="the physics inherits a socket")
def test_the_real_firmware_flies_on_our_physics(arducopter):
    with launch_on_physics(SimOptions(airframe="rotor", speed=5.0, seed=3), binary=Path(arducopter)) as vehicle:
        seen = fly_a_minute(vehicle.url)
        assert vehicle.alive
    assert seen["height_m"] > 5.0
    assert seen["roll_rad"] == pytest.approx(0.2, abs=0.04)
    assert seen["voltage_v"] == pytest.approx(25.0, abs=0.4)  # through two range finders and the script


@pytest.mark.sitl
@pytest.mark.skipif(sys.platform == "win32", reason="the physics inherits a socket")
def test_the_real_firmware_flies_an_identified_model(arducopter):
    model = Model(("linear_drag",))
    values = model.start({"omega_phi": 12.0, "omega_theta": 12.0, "zeta_phi": 0.7, "zeta_theta": 0.7, "sigma_r": 5.0})
    file = ModelFile(model, {}, values, (), np.zeros((0, 0)), {"voltage_v": [21.0, 24.5]}, path="model.yaml")
    options, frame = firmware_options(file, speed=2.0, seed=3)
    with launch_on_physics(options, binary=Path(arducopter)) as vehicle:
        seen = fly_a_minute(vehicle.url)
        assert vehicle.alive
    assert frame.notes  # no gains were recorded: they are chosen
    assert seen["height_m"] > 5.0
    assert seen["roll_rad"] == pytest.approx(0.2, abs=0.03)
    assert seen["hover_throttle"] == pytest.approx(float(model.hover_throttle(values, 24.3)), abs=0.015)
