"""As on Windows: every module is imported, and a log is fitted, diagnosed and reported, without what only POSIX and Linux have.

The system itself is not here: the modules, functions and signals that it lacks are taken away in a process of its own. What macOS lacks
of them (`os.sched_*`) is among these.
"""

import re
import subprocess
import sys

import pytest

# What Python's documentation marks "Unix" or "not Windows".
WINDOWS = """
gone = "fcntl grp posix pty pwd resource syslog termios tty".split()
functions = '''chown fork forkpty getegid geteuid getgid getgroups getpgid getpriority getuid kill killpg mkfifo nice openpty
register_at_fork sched_getaffinity sched_getparam sched_getscheduler sched_param sched_setaffinity sched_setscheduler setpriority setsid
sysconf uname wait4'''.split()
signals = "SIGALRM SIGCHLD SIGHUP SIGKILL SIGQUIT SIGUSR1 SIGUSR2 setitimer pthread_sigmask".split()
methods = ["spawn"]
"""
TAKE_AWAY = """
import importlib, multiprocessing, os, pkgutil, signal, sys
# Other packages have their own branch for each system, which this one cannot take.
for name in '''casadi click mcap_ros2.decoder mcap.reader numpy pandas plotly.graph_objects pyarrow.parquet pymavlink.mavutil
pyulog rich.console rich.live scipy.optimize scipy.signal scipy.io scipy.interpolate scipy.special serial serial.tools.list_ports
concurrent.futures.process multiprocessing.popen_fork multiprocessing.popen_spawn_posix subprocess tempfile shutil asyncio'''.split():
    importlib.import_module(name)


class Gone:
    def find_spec(self, name, path=None, target=None):
        if name in gone:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


for name in gone:
    sys.modules.pop(name, None)
sys.meta_path.insert(0, Gone())
for name in functions:
    if hasattr(os, name):
        delattr(os, name)
for name in signals:
    if hasattr(signal, name):
        delattr(signal, name)
multiprocessing.get_all_start_methods = lambda: methods

import flighttest

for module in pkgutil.walk_packages(flighttest.__path__, "flighttest."):
    if not module.name.endswith("__main__"):
        importlib.import_module(module.name)
print("imported")

from flighttest.cli.main import main

for words in sys.argv[1].split(";"):
    sys.argv = ["flighttest", *words.split()]
    try:
        main()
    except SystemExit as end:
        print("ended with", end.code)
"""


@pytest.mark.slow
def test_a_log_is_fitted_diagnosed_and_reported_without_what_windows_lacks(repository, tmp_path):
    log = repository / "tests" / "data" / "sitl_roll_pitch.tlog.xz"
    words = (
        f"fit {log} -o model.yaml;import {log} -o run;show run;diagnose run --model model.yaml -o diagnosis;report diagnosis;"
        "check short.yaml;run short.yaml --only fly --yes"
    )
    script = (repository / "maneuvers" / "yaw_rate.yaml").read_text(encoding="utf-8")
    short = script.replace("[1, 2]", "[1]").replace("each: 2", "each: 1")  # two steps of eight
    (tmp_path / "short.yaml").write_text(short, encoding="utf-8")
    assert short != script
    found = subprocess.run(
        [sys.executable, "-c", WINDOWS + TAKE_AWAY, words], cwd=tmp_path, capture_output=True, text=True, timeout=300
    )
    assert found.returncode == 0, found.stderr[-3000:]
    assert "imported" in found.stdout
    assert "Traceback" not in found.stdout + found.stderr
    ended = re.findall(r"ended with (\S+)", found.stdout)
    assert ended == ["0"] * 7, found.stdout[-2000:] + found.stderr[-2000:]
    assert (tmp_path / "diagnosis" / "report.html").is_file()
