"""`fly`: connect, check, record, fly, restore. The order of one flight, and its end whatever happens."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from flighttest.errors import FlighttestError, LinkError, PreflightError, RecordingError
from flighttest.flight.checklist import asked, checklist
from flighttest.flight.execution import supervisor
from flighttest.flight.execution.control import FlightControl, Stops
from flighttest.flight.execution.legs import AutopilotSettings
from flighttest.flight.execution.machine import Event, FlightState
from flighttest.flight.execution.placing import place_home, place_zone
from flighttest.flight.execution.scheduler import Scheduler
from flighttest.flight.gate import GateLimits
from flighttest.flight.leaving import left_words, may_restore, record_fall, records_behind
from flighttest.flight.options import FlightSettings
from flighttest.flight.outcome import FlightEnded, FlightOutcome
from flighttest.flight.preparation import preflight, priority
from flighttest.flight.preparation.changes import (
    ExternalChanges,
    LeftParameter,
    ParameterChanges,
    changed_values,
    record_of,
    still_left,
)
from flighttest.flight.preparation.fence import ZoneFence
from flighttest.flight.preparation.fence_limits import fence_words
from flighttest.flight.preparation.rates import Telemetry, fitted_to_seen
from flighttest.flight.preparation.situation import Check, Situation
from flighttest.flight.recorder import Recorder, first_manifest
from flighttest.flight.result import FlightResult
from flighttest.link import lockstep
from flighttest.link import parameters as params
from flighttest.link.ardupilot import ArduPilot
from flighttest.link.clock import Clock
from flighttest.link.port import MavlinkPort
from flighttest.link.session import Session, StoppedByOperator
from flighttest.link.streams import StreamRates
from flighttest.link.transport import Transport, open_transport
from flighttest.mavlink import mode_name
from flighttest.mavlink.dialect import dialect
from flighttest.plan import Plan
from flighttest.recording.manifest import FenceData

POSITION_WAIT_S = 90.0
_POSITION_PATIENCE_S = 5.0  # where none is needed
_LISTEN_AFTER_TAKE_OVER_S = 2.0


def fly(
    plan: Plan,
    link_url: str,
    run_dir: Path,
    options: FlightSettings | None = None,
    *,
    transport: Transport | None = None,
    clock: Clock | None = None,
) -> FlightResult:
    """Fly a plan on a vehicle and record it into run_dir.

    link_url: see `link.transport.URL_FORMS`; transport: in its place, for a vehicle in this process; clock: where its time comes from.
    LinkError when the vehicle cannot be reached, PreflightError when it must not fly; everything later is an outcome.
    """
    options = options or FlightSettings()
    opened = transport if transport is not None else open_transport(link_url)
    session = Session(MavlinkPort(opened, system=options.system, key=options.signing_key), clock)
    manifest = first_manifest(plan, link_url, options.weather, options.resume)
    manifest |= records_behind(run_dir.name, options.left_behind, options.fence_behind)
    recorder = Recorder(run_dir, session.clock.ground_s, manifest, plan)
    session.port.tap(recorder.tap)
    flight = _Flight(plan, session, recorder, options, real_clock=clock is None)
    try:
        return flight.run()
    finally:
        flight.held.close()
        session.port.close()
        recorder.close()


class _Flight:
    """One flight from the first HEARTBEAT to the restored parameters."""

    def __init__(
        self, plan: Plan, session: Session, recorder: Recorder, options: FlightSettings, *, real_clock: bool
    ) -> None:
        self.plan = plan
        self.session = session
        self.recorder = recorder
        self.options = options
        self._real_clock = real_clock
        self.vehicle = ArduPilot(session)
        self.notes: list[str] = []
        self.held = contextlib.ExitStack()
        self._stage = options.on_stage
        self._parameters: dict[str, float] = {}
        self._changes: ParameterChanges | None = None
        self._fence: ZoneFence | None = None
        self._checklist = ""
        self._control: FlightControl | None = None
        self._unrestored = changed_values(options.left_behind)  # also where the vehicle is never reached
        self._external_changes = ExternalChanges({})

    def run(self) -> FlightResult:
        """The flight, from connecting to what it leaves."""
        confirm = self.options.confirm
        scheduler: Scheduler | None = None
        outcome = FlightOutcome.VEHICLE_REFUSED
        why = ""
        try:
            control = self._prepare()
            if confirm is not None and not asked(control, confirm, self._checklist):
                raise PreflightError([("the operator did not confirm", "answer yes, or use --yes")])
            settings = AutopilotSettings.of(self._parameters)
            scheduler = Scheduler(control, self.plan, settings, frozenset(self.options.skip), self.options.replanner)
            scheduler.on_armed = lambda: place_home(control, self.plan.vehicle.zone)
            try:
                outcome = scheduler.fly()
            except FlightEnded as ended:
                outcome, why = ended.outcome, ended.why
            except LinkError as error:
                # The vehicle is in the air, or may be: land it with what is left of the link, then report what happened.
                why = str(error)
                try:
                    outcome = scheduler.land_after(error)
                except FlightEnded as ended:
                    outcome = ended.outcome
            except BaseException:  # a defect of ours, whatever it is, must not leave the vehicle with a step's throttle; it is raised after
                with contextlib.suppress(Exception):  # whatever fails again here is the lesser news
                    supervisor.release(control, "the program failed")
                raise
        except StoppedByOperator:
            outcome = FlightOutcome.OPERATOR_STOP
        except FlighttestError as error:
            self.recorder.manifest["outcome"] = str(error)
            raise
        finally:
            self.session.stop_asked = None
            try:
                left = self._close()
            finally:  # a defect of ours may be met again here; how the vehicle is left is known all the same
                state = scheduler.control.machine.on(Event.OVER) if scheduler is not None else FlightState.NOT_ARMED
        if why:
            self.notes.append(why)
        self.recorder.manifest |= {
            "outcome": outcome.value,
            "outcome_name": outcome.name,
            "vehicle_left": state.name,
            "legs": [
                {"id": r.leg, "outcome": r.outcome.name, "why": list(r.why)}
                for r in (scheduler.results if scheduler else [])
            ],
            "notes": [*self.notes, *(scheduler.notes if scheduler else []), *self._external_changes.changed],
        }
        self.recorder.save_manifest()
        self._stage("writing the channels")
        self.recorder.finish(self.session, scheduler.plan if scheduler else self.plan)
        if self.recorder.failure:
            why = self.recorder.incomplete or f"the record could not be written for a while: {self.recorder.failure}"
            self.recorder.manifest["notes"].append(why)
        return FlightResult(
            outcome,
            self.recorder.run_dir,
            tuple(scheduler.results) if scheduler else (),
            tuple(self.recorder.manifest["notes"]),
            left,
            state,
            mode_name(self.vehicle.mode),
            incomplete=self.recorder.incomplete,
        )

    # -- before --------------------------------------------------------------------------------------------------------------

    def _prepare(self) -> FlightControl:
        session, vehicle = self.session, self.vehicle
        set_params, waived = self.options.set_params, frozenset(self.options.waive)
        session.stop_asked = lambda: self.options.stop_requested() > 0  # until something is set that must be restored
        self._stage("connecting")
        beat = session.connect()
        if beat.autopilot != dialect.MAV_AUTOPILOT_ARDUPILOTMEGA:
            raise LinkError(
                "the vehicle is not ArduPilot, the only firmware whose flights this version schedules",
                "fly it with its own tools and import the log (.ulg of PX4); link.px4 was never tried on a real PX4",
            )
        preflight.refuse_other_vehicles(beat, waived)
        offered = params.offered(session, lockstep.PARAMETER)
        if offered is not None:
            self._enter_lock_step(offered)
        self._stage("reading parameters")
        self._parameters = params.read_all(session)
        if lockstep.PARAMETER in self._parameters and not session.lock_step:
            # A host under load may have missed the answer above; free-running at many times real time would spoil the delays.
            self._enter_lock_step(self._parameters[lockstep.PARAMETER])
        simulator = preflight.is_simulator(self._parameters)
        if not simulator:
            session.clock.keep_real_time()
            self.held.enter_context(priority.first())
        if self._real_clock and not session.lock_step and session.clock.pace == 1.0:
            self.held.callback(session.port.send_on_time())
        firmware = vehicle.firmware()
        self.recorder.manifest |= {
            "firmware": f"ArduCopter {firmware}" if firmware else "",
            "autopilot": vehicle.hardware,
            "parameters": self._parameters,
        }
        self.recorder.save_manifest()
        self._stage("asking for telemetry")
        telemetry = Telemetry(vehicle, self.plan, self.recorder.manifest["connect"])
        telemetry.ask()
        control = self._control = FlightControl(
            vehicle,
            self._gate(),
            self.recorder,
            rate_hz=self.plan.rate_hz,
            stops=Stops(self.options.stop_requested),
            external_changes=self._external_changes,
            on_progress=self.options.on_progress,
        )
        real_time = not simulator or session.lock_step or session.clock.pace == 1.0
        telemetry.measure(real_time)  # what a full link drops may be the position
        self._wait_for_position(control)
        rates = telemetry.measure(real_time)
        self.notes += telemetry.notes
        control.after()
        situation = Situation(
            self.plan, self._parameters, control.state, rates, firmware, beat.type, simulator,
            rc_live=simulator or preflight.rc_live(vehicle), pace=self._pace, others=frozenset(session.others),
        )  # fmt: skip
        control.use_channels(self._parameters)
        self.recorder.flush(force=True)  # what comes in half a second is still in memory
        if self.recorder.failure:
            raise RecordingError(
                f"{self.recorder.run_dir} cannot be written: {self.recorder.failure}",
                "free some space, or choose --out",
            )
        self._stage("checking the vehicle")
        session.stop_asked = None
        self._inherit(set_params or simulator)
        placed, outside_m = place_zone(control, self.plan.vehicle.zone)
        found = [*preflight.checks(situation), *preflight.home_checks(outside_m)]
        if simulator:
            what = "was" if self.plan.vehicle.zone.fence == "polygon" else "and a fence were"
            self.notes.append(f"a simulator: live RC input {what} not asked for; parameters are set as needed")
        if set_params or simulator:
            found = self._mend(found, waived)
        self.options.on_vehicle(self.recorder.manifest["firmware"], dict(self._parameters))
        self.notes += preflight.waiver_notes(found, waived)
        preflight.refuse(found, waived)
        self._note(preflight.battery_words(situation))
        self._announce(fence_words(replace(situation, parameters=self._parameters)))
        self.notes += filter(None, [placed])
        self.recorder.manifest["rates_hz"] = {name: round(rate, 1) for name, rate in rates.items()}
        self.recorder.save_manifest()
        self._bring_fence(control, set_params or simulator)
        self._external_changes.known.update(self._parameters)
        self._checklist = checklist(self.plan, replace(situation, parameters=self._parameters), tuple(sorted(waived)))
        session.clock.hold()
        control.streams = StreamRates(vehicle, telemetry.granted_hz, rates, fitted_to_seen)
        return control

    def _enter_lock_step(self, offered: float) -> None:
        if offered != 1.0:
            known = {lockstep.PARAMETER: offered}
            params.write_parameter(self.session, lockstep.PARAMETER, 1.0, known, stops_time=True)
        self._parameters[lockstep.PARAMETER] = 1.0
        self.session.enter_lock_step()
        self.recorder.use_clock(self.session.clock.ground_s)

    def _mend(self, found: list[Check], waived: frozenset[str]) -> list[Check]:
        assert self._changes is not None
        # Nothing is set on a vehicle that will not fly: somebody may be flying it.
        preflight.refuse([check for check in found if not check.set], waived)
        mended = [check for check in found if check.set and check.name not in waived]
        wanted = {name: value for check in mended for name, value in check.set.items()}
        self._changes.apply(wanted, self._note, self._keep_changed, lambda: self.vehicle.armed)
        self.recorder.manifest["parameters"] = dict(self._parameters)
        self.recorder.save_manifest()
        return [check for check in found if check not in mended]

    def _keep_changed(self, pending: Mapping[str, LeftParameter]) -> None:
        self.recorder.manifest["parameters_changed"] = changed_values(pending)
        self.recorder.manifest["parameters_set"] = record_of(self.recorder.run_dir.name, pending)
        self.recorder.save_manifest()

    def _inherit(self, restoring: bool) -> None:
        """What an earlier flight set and what has not been restored since."""
        known = self._parameters
        left, words = still_left(self.options.left_behind, known, self.vehicle.hardware)
        self._unrestored = {} if restoring else changed_values(left)
        self._changes = ParameterChanges(self.session, known, left if restoring else {}, self.vehicle.hardware)
        after = "it is restored after this flight" if restoring else "set it back by hand, or fly with --set-params"
        for name, value in changed_values(left).items():
            is_and_should = f"{preflight.figure(known[name])} instead of {preflight.figure(value)}"
            words.append(f"an earlier flight left {name} at {is_and_should}: {after}")
        self._fence = ZoneFence(self.vehicle, self.recorder.run_dir.name, self._keep_fence)
        words += filter(None, [self._fence.inherit(self.options.fence_behind, restoring=restoring)])
        for text in words:
            self._announce(text)
        self._keep_changed(left)

    def _keep_fence(self, record: FenceData) -> None:
        self.recorder.manifest["fence_set"] = record
        self.recorder.save_manifest()

    def _bring_fence(self, control: FlightControl, may_set: bool) -> None:
        """The zone's polygon, where the zone asks for one; and into force what was changed."""
        assert self._fence is not None
        assert self._changes is not None
        along = self.plan.vehicle.zone.fence == "polygon" and "fence" not in self.options.waive
        if along:
            self._stage("bringing the zone's fence onto the vehicle")
            control.until(self.session.now_s() + 0.3)  # a position about the zone's origin
            place = control.state, control.reader.origin_m
            preflight.refuse_armed(self.vehicle.armed)
            self._note(self._fence.put(self.plan, *place, may_set=may_set, extend=self.options.extend_fence))
            if "FENCE_TOTAL" in self._parameters:
                self._parameters["FENCE_TOTAL"] = params.read_parameter(self.session, "FENCE_TOTAL") or 0.0
        if along or any(name.startswith("FENCE_") for name in self._changes.pending):
            self._fence.switch_on()

    def _note(self, text: str) -> None:
        if text:
            self.notes.append(text)
            self.recorder.event("note", text, self.session.now_s())

    def _announce(self, text: str) -> None:
        """Into the record and onto the screen, where there is a text."""
        self._note(text)
        if text:
            self._stage(text)

    def _gate(self) -> GateLimits:
        simulator = preflight.is_simulator(self._parameters)
        held_up_max_s = 0.5 * self._pace if simulator else 0.5 * preflight.TIMEOUT_S + 1.0 / self.plan.rate_hz
        return GateLimits.of(self.plan, self._pace, held_up_max_s)

    @property
    def _pace(self) -> float:
        """How much faster than real time the vehicle runs, at least 1: what the host takes a moment for is longer for it. A real vehicle
        keeps real time, whatever a stalling link makes of it."""
        return max(self.session.clock.pace, 1.0) if preflight.is_simulator(self._parameters) else 1.0

    def _wait_for_position(self, control: FlightControl) -> None:
        """After boot the estimate needs half a minute and more; without a position only its absence is noted."""
        wanted = self.plan.reset.by == "guided"
        began = self.session.now_s()
        self._stage("waiting for the vehicle's position estimate")
        while not control.stop_asked:
            state, waited_s = control.state, self.session.now_s() - began
            enough = state.position_ok or (not wanted and waited_s >= _POSITION_PATIENCE_S)
            if (enough and state.ekf_ok and state.attitude_rad) or not 0.0 <= waited_s < POSITION_WAIT_S:
                break
            self.session.require_link()
            control.until(self.session.now_s() + 0.5)
        if not wanted and not control.state.position_ok:
            source = control.reader.height_source or "nothing: height is not judged"
            self.notes.append(f"no position: zone and speed are not judged; height is, from {source}")

    # -- after ---------------------------------------------------------------------------------------------------------------

    def _may_restore(self) -> bool:
        return may_restore(self.vehicle, self._control)

    def _close(self) -> dict[str, float]:
        """Restore what was set, and record the last words. Never raises: the flight's own outcome must not be hidden."""
        self._announce(record_fall(self._control))
        self._external_changes.known.clear()  # what changes from now on is restored
        left: dict[str, float] = {}
        if self._fence is not None:
            self._announce(self._fence.restore(may=self._may_restore()))
        if self._changes is not None and self._changes.pending:
            if self._may_restore():
                self._stage("restoring parameters")
            try:
                left = self._changes.restore(self._may_restore)
            except (FlighttestError, FlightEnded) as error:  # the link, or a pilot who takes over the released vehicle
                left = self._changes.pending
                self.notes.append(str(error))
            for text in self._changes.left_alone:
                self._announce(text)
        for text in self.session.port.left_out():
            self._note(text)
        left |= self._unrestored
        if left:
            self._announce(left_words(left, self._changes.unconfirmed if self._changes is not None else ()))
        self.recorder.manifest["parameters_left"] = left
        if self.session.port.muted and not self.session.lock_step:
            self.session.advance(self.session.now_s() + _LISTEN_AFTER_TAKE_OVER_S)
        self.recorder.flush(force=True)
        self.recorder.save_manifest()
        return left
