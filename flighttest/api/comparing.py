"""The verbs that compare: a simulator with reality, a twin with its recordings, a changed vehicle with itself, one model with another.

Each calls the step of `pipeline` that the command of the same name calls, as those in `verbs` do.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Unpack

from flighttest.api.inputs import (
    AnyPath,
    ProgressLike,
    ReadingOptions,
    Source,
    as_model,
    as_path,
    as_progress,
    as_sources,
    reading_options,
)

if TYPE_CHECKING:
    from flighttest.api.comparisons import Compared, Opposed, Replayed, Twin
    from flighttest.api.fitted_model import FittedModel


def against(
    real: Source | Iterable[Source],
    simulated: Source | Iterable[Source],
    *,
    model: FittedModel | AnyPath | None = None,
    vehicle: AnyPath | None = None,
    output: AnyPath | None = None,
    columns: AnyPath | None = None,
    progress: ProgressLike | None = None,
    **options: Unpack[ReadingOptions],
) -> Opposed:
    """Find what a simulator lacks, has too much of or has with another value, from its recordings and real ones of the same vehicle.

    model: what both diagnoses start from, the paper's where none is given. output: folder for against.json, report.html and model.yaml
    (of the real recordings). options: `flighttest.api.inputs.ReadingOptions`. InputError where one recording is on both sides.
    """
    from flighttest.api.comparisons import Opposed
    from flighttest.api.fitted_model import model_of
    from flighttest.identify.models import model_file
    from flighttest.pipeline.diagnosis.against import against as oppose
    from flighttest.pipeline.recordings.sources import Reading

    result = oppose(
        as_sources(real), as_sources(simulated), None if model is None else as_model(model), as_path(output), as_path(vehicle),
        Reading(as_path(columns), **reading_options(options)), as_progress(progress),
    )  # fmt: skip
    mine = result.value.real
    fitted = model_of(mine, model_file.as_data(mine))
    return Opposed(document=result.document, data=result.data, status=result.status, found=result.value, model=fitted)


def twin(
    model: FittedModel | AnyPath,
    *sources: Source,
    offline: bool = False,
    backend: Literal["builtin", "sitl"] = "builtin",
    seed: int = 1,
    output: AnyPath | None = None,
    columns: AnyPath | None = None,
    progress: ProgressLike | None = None,
) -> Twin:
    """Fly an identified model as a vehicle, as it was recorded, and report what still differs.

    The scripts of recorded runs are flown behind the built-in autopilot, or with backend="sitl" under the real ArduCopter on this machine
    (LinkError without one), where the steps are compared as flown; logs and runs without a script, or all of them with offline=True,
    are compared with what the model makes of their recorded commands. output: folder that keeps the twin's flights and report.html.
    `simulate(model=...)` lets it fly for any ground station.
    """
    from flighttest.api.comparisons import Twin
    from flighttest.pipeline.twin import Flying, verify

    result = verify(
        as_model(model),
        as_sources(sources),
        as_path(output),
        flying=Flying(offline, backend == "sitl", seed),
        columns=as_path(columns),
        progress=as_progress(progress),
    )
    flown = tuple(Path(folder) for folder in result.data["flown"])
    return Twin(document=result.document, data=result.data, status=result.status, diagnosis=result.value, flown=flown)


def replay(
    model: FittedModel | AnyPath,
    *sources: Source,
    changes: Mapping[str, str | float] | Sequence[str] = (),
    output: AnyPath | None = None,
    columns: AnyPath | None = None,
    progress: ProgressLike | None = None,
) -> Replayed:
    """Run recorded commands on the vehicle of a model with changes, beside the recording.

    changes: payload (kg), battery (V, or '+1', '-1'), propeller (ratio), or a parameter: {"K": "+10%", "w_north": 3.0}, or as words:
    ["K=+10%"]. output: folder for report.html. InputError for a change of what the model does not have.
    """
    from flighttest.api.comparisons import Replayed
    from flighttest.pipeline.twin import replay as run_commands

    words = [f"{k}={v}" for k, v in changes.items()] if isinstance(changes, Mapping) else list(changes)
    result = run_commands(
        as_model(model), as_sources(sources), words, as_path(output), as_path(columns), as_progress(progress)
    )
    return Replayed(document=result.document, data=result.data, status=result.status, found=result.value)


def compare(
    first: FittedModel | AnyPath, second: FittedModel | AnyPath, *, progress: ProgressLike | None = None
) -> Compared:
    """Compare two models, or the fits of two runs or logs: z-scores per parameter, and which differ."""
    from flighttest.api.comparisons import Compared
    from flighttest.pipeline.identification.comparison import compare as compare_models

    result = compare_models(as_model(first), as_model(second), as_progress(progress))
    return Compared(document=result.document, data=result.data, status=result.status, differences=result.value)
