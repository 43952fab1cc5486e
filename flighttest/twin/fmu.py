"""An identified model as a functional mock-up unit (FMI 2.0, co-simulation): every term, with its delays, as compiled C and its source."""

from __future__ import annotations

import hashlib
import platform
import shutil
import subprocess
import sys
import tempfile
import zipfile
from importlib import resources
from pathlib import Path
from xml.sax.saxutils import quoteattr

import casadi as ca

from flighttest.channels import CHANNELS
from flighttest.errors import InputError
from flighttest.identify.models.export import c_code, functions, hover_input, hover_state
from flighttest.identify.models.model_file import ModelFile
from flighttest.version import __version__

NAME = "flighttest_model"
MOST_STEP_S = 0.005  # below a fifth of the shortest lag a fit may find (150 1/s)
_SOURCES = (f"{NAME}.c", f"{NAME}.h", "fmu_data.h", "fmu.c")
_OUTPUT_REF, _START_REF = 100, 200


def write_fmu(stored: ModelFile, folder: Path) -> Path:
    """Write flighttest_model.fmu for this machine's system. InputError without a C compiler."""
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        raise InputError(
            "an FMU holds a compiled library, and no C compiler is found", "install one (cc), or export --to c"
        )
    folder.mkdir(parents=True, exist_ok=True)
    target = folder / f"{NAME}.fmu"
    with tempfile.TemporaryDirectory() as scratch:
        here = Path(scratch)
        c_code([functions(stored)["step"], outputs(stored)], here)
        guid = hashlib.sha256((here / f"{NAME}.c").read_bytes()).hexdigest()[:32]
        (here / "fmu_data.h").write_text(_data(stored, guid), encoding="utf-8")
        source = resources.files("flighttest.twin").joinpath("fmu.c").read_text(encoding="utf-8")
        (here / "fmu.c").write_text(source, encoding="utf-8")
        library = f"{NAME}{ {'win32': '.dll', 'darwin': '.dylib'}.get(sys.platform, '.so') }"
        words = [compiler, "-O2", "-shared", "-fPIC", "-fvisibility=hidden", "-o", library, "fmu.c", f"{NAME}.c", "-lm"]
        made = subprocess.run(words, cwd=here, capture_output=True, text=True, check=False)
        if made.returncode != 0:
            raise InputError(
                f"the C compiler refused the model: {made.stderr.strip()[-300:]}", "export --to c and build it by hand"
            )
        with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("modelDescription.xml", model_description(stored, guid))
            archive.write(here / library, f"binaries/{_platform()}/{library}")
            for name in _SOURCES:
                archive.write(here / name, f"sources/{name}")
    return target


def outputs(stored: ModelFile) -> ca.Function:
    """y = outputs(x, u): the channels, as measured."""
    system = stored.model.system
    x, u = ca.SX.sym("x", len(system.states)), ca.SX.sym("u", len(system.inputs))
    y = system.function(x, u, ca.DM([stored.values[n] for n in system.params]))[1]
    return ca.Function("outputs", [x, u], [ca.cse(ca.densify(y))], ["x", "u"], ["y"])


def inputs_of(stored: ModelFile) -> list[str]:
    """Inputs of the unit; the time since take-off, where a term asks for it, is the simulation's own."""
    return [n for n in stored.model.system.inputs if n != "time_s"]


def _data(stored: ModelFile, guid: str) -> str:
    system, delays = stored.model.system, stored.delays_s
    names, given = list(system.inputs), inputs_of(stored)
    late = [max(delays.get(system.input_delay[n], 0.0), 0.0) for n in given]
    start_u = dict(zip(names, hover_input(stored).tolist(), strict=True))

    def row(values: list[float]) -> str:
        return "{" + ", ".join(f"{v:.17g}" for v in values) + "}"

    lines = [
        f"#define N_X {len(system.states)}",
        f"#define N_U {len(names)}",
        f"#define N_IN {len(given)}",
        f"#define N_Y {len(system.outputs)}",
        f"#define TIME_AT ({names.index('time_s') if 'time_s' in names else -1})",
        f"#define MOST_STEP_S {MOST_STEP_S!r}",
        f"#define LONGEST_DELAY_S {max(late) + 0.001:.17g}",
        f'#define GUID "{guid}"',
        f"static const int INPUT_AT[N_IN] = {{{', '.join(str(names.index(n)) for n in given)}}};",
        f"static const double DELAY_S[N_IN] = {row(late)};",
        f"static const double START_X[N_X] = {row(start_state(stored))};",
        f"static const double START_U[N_IN] = {row([start_u[n] for n in given])};",
    ]
    return "\n".join(lines) + "\n"


def start_state(stored: ModelFile) -> list[float]:
    """At rest, thrust equal to weight, the states of added terms at their initial values."""
    system = stored.model.system
    return [float(v) + system.initial.get(n, 0.0) for n, v in zip(system.states, hover_state(stored), strict=True)]


def model_description(stored: ModelFile, guid: str) -> str:
    """modelDescription.xml."""
    system = stored.model.system
    start_u = dict(zip(system.inputs, hover_input(stored).tolist(), strict=True))
    rows, units = [], dict[str, None]()

    def variable(name: str, ref: int, unit: str, doc: str, kind: str, start: float | None) -> None:
        units[unit] = None
        value = "" if start is None else f' start="{start:.17g}"'
        real = f"<Real{value}{f' unit={quoteattr(unit)}' if unit != '1' else ''}/>"
        rows.append(
            f'<ScalarVariable name={quoteattr(name)} valueReference="{ref}" description={quoteattr(doc)} {kind}>{real}</ScalarVariable>'
        )

    for i, n in enumerate(inputs_of(stored)):
        doc = CHANNELS[n].doc if n in CHANNELS else n
        variable(n, i, system.inputs[n], doc, 'causality="input" variability="continuous"', start_u[n])
    first = len(rows) + 1
    for i, n in enumerate(system.outputs):
        kind = 'causality="output" variability="continuous" initial="calculated"'
        variable(
            n if n not in system.inputs else f"{n}_out", _OUTPUT_REF + i, CHANNELS[n].unit, CHANNELS[n].doc, kind, None
        )
    for i, (n, unit) in enumerate(system.states.items()):
        kind = 'causality="parameter" variability="fixed" initial="exact"'
        variable(f"start.{n}", _START_REF + i, unit, f"{n} at the start", kind, start_state(stored)[i])
    listed = "".join(f'<Unknown index="{first + i}"/>' for i in range(len(system.outputs)))
    defined = "".join(f"<Unit name={quoteattr(u)}/>" for u in units if u != "1")
    body = "\n    ".join(rows)
    files = "".join(f'<File name="{n}"/>' for n in _SOURCES if n.endswith(".c"))
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="{NAME}" guid="{guid}" generationTool="flighttest {__version__}"
  description={quoteattr("identified multirotor: " + ", ".join(stored.model.terms))} variableNamingConvention="structured">
  <CoSimulation modelIdentifier="{NAME}" canHandleVariableCommunicationStepSize="true">
    <SourceFiles>{files}</SourceFiles>
  </CoSimulation>
  <UnitDefinitions>{defined}</UnitDefinitions>
  <DefaultExperiment startTime="0" stopTime="10" stepSize="0.01"/>
  <ModelVariables>
    {body}
  </ModelVariables>
  <ModelStructure>
    <Outputs>{listed}</Outputs>
    <InitialUnknowns>{listed}</InitialUnknowns>
  </ModelStructure>
</fmiModelDescription>
"""


def _platform() -> str:
    bits = "64" if sys.maxsize > 2**32 else "32"
    system = {"Windows": "win", "Darwin": "darwin"}.get(platform.system(), "linux")
    return f"{system}{bits}"
