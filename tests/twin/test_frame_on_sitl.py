"""An exported frame, flown on ArduPilot's own physics: it is what `frame_model` says, to the noise floors, and its loops are as stated."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flighttest.diagnose.residuals.prediction import prediction_quality
from flighttest.flight import FlightSettings, fly
from flighttest.identify.fit import fit
from flighttest.identify.models.model_file import ModelFile, StoredParameter
from flighttest.physics.model import Model
from flighttest.pipeline.identification.fitting import cut_all
from flighttest.pipeline.planning.checking import plans
from flighttest.pipeline.planning.predictor import ModelPredictor, ScriptReplanner
from flighttest.pipeline.recordings.sources import open_recordings
from flighttest.sim.sitl.launcher import SitlOptions, launch
from flighttest.twin import ardupilot
from flighttest.twin.firmware import wanted_answers
from flighttest.twin.flown import DRIVEN, mean_steps
from flighttest.vehicle.model import DEFAULT_VEHICLE

VALUES = {
    "omega_phi": 12.0, "omega_theta": 12.0, "zeta_phi": 0.8, "zeta_theta": 0.8, "sigma_r": 5.0, "sigma_t": 16.6, "K": 51.5, "alpha": 1.6,
    "d_x": 0.32, "d_y": 0.31, "d_z": 0.41, "k_x": 0.05, "k_y": 0.05, "k_z": 0.06,
    "T_d_attitude": 0.02, "T_d_yaw_rate": 0.02, "T_d_thrust": 0.02,
}  # fmt: skip
# Where no step is repeated, the noise floor of an instrument (docs/diagnosis.md).
FORCE_M_S2, VELOCITY_M_S = 0.05, 0.03


@pytest.mark.sitl
def test_an_exported_frame_flies_within_what_is_stated(arducopter, tmp_path):
    model = Model(("linear_drag", "quadratic_drag"))
    parameters = {n: StoredParameter(VALUES[n], model.param[n].unit, None) for n in model.names}
    file = ModelFile(
        model, parameters, model.start(VALUES), (), np.zeros((0, 0)), {"voltage_v": [22.0, 25.0]}, path="model.yaml"
    )
    _, made = ardupilot.write_frame(file, tmp_path)
    kept, values = ardupilot.frame_model(file, made.loops)
    prior = ModelPredictor(model, file.values)
    (plan,) = plans(["spot_check"], replace(DEFAULT_VEHICLE, name="exported"), prior)
    options = SitlOptions(frame=tmp_path, speedup=2.0, folder=tmp_path / "sitl")
    with launch(options, binary=Path(arducopter)) as vehicle:
        ended = fly(
            plan, vehicle.url, tmp_path / "run", FlightSettings(set_params=True, replanner=ScriptReplanner(plan, prior))
        )
        assert ended.outcome.orderly
        log = vehicle.onboard_logs[-1]
    segments = [s for s in cut_all(open_recordings([log])) if s.usable and s.kind in DRIVEN]
    assert len(segments) >= 8, ended.sentence  # a busy machine sends targets late, and the steps are rejected
    # The onboard log has the times at which the firmware received the targets: no delay of a link is in it.
    values |= {"T_d_thrust": ardupilot.FIRMWARE_THRUST_DELAY_S}
    noise = fit(segments, kept, select="all", start=values).noise
    error = {c: q.rmse for c, q in prediction_quality(segments, kept, values, noise).items()}
    assert max(error[c] for c in ("f_x_m_s2", "f_y_m_s2", "f_z_m_s2")) < FORCE_M_S2
    assert max(error[c] for c in ("v_x_m_s", "v_y_m_s", "v_z_m_s")) < VELOCITY_M_S
    unlike = prediction_quality(segments, model, {**file.values, "T_d_thrust": 0.0}, noise)
    assert unlike["f_z_m_s2"].rmse > 2.0 * FORCE_M_S2  # what the frame cannot be is not small
    for axis, stated in (("roll", made.tilt_share), ("pitch", made.tilt_share), ("yaw", made.yaw_share)):
        (block,) = mean_steps(segments)[axis]
        y = np.array(block["answer"]) / block["size"]
        t = block["period_s"] * np.arange(y.size)
        wanted = wanted_answers(file, axis)[-1]
        moves = np.arange(-0.05, 0.05, 0.001)
        off = min(np.sqrt(np.mean((np.interp(t + m, wanted.t_s, wanted.answer / wanted.step) - y) ** 2)) for m in moves)
        assert off < stated, axis
