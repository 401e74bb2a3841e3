"""``import fopid_core as fopid``: one import, text everywhere, degrees by name, results that show themselves."""

from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import control
import numpy as np
import pytest

import fopid_core as fopid
from fopid_core.model.two_degrees import MeasurementFilter, SetpointWeights

PLANT = "2/(s+1)^3 * exp(-0.2s)"
GAINS = (0.4, 0.3, 0.3, 1.0, 0.9)


def test_the_import_loads_neither_scipy_nor_numpy() -> None:
    code = (
        "import sys, time; begun = time.process_time(); import fopid_core as fopid; "
        "took = time.process_time() - begun; loaded = {'numpy', 'scipy', 'lark', 'matplotlib'} & set(sys.modules); "
        "fopid.read_process('1/(s+1)'); print(took < 0.2, sorted(loaded), 'scipy' in sys.modules)"
    )
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert told.strip() == "True [] False"


@pytest.mark.parametrize("name", fopid.__all__)
def test_every_name_is_there_and_says_what_it_is(name: str) -> None:
    assert name in dir(fopid)
    assert getattr(fopid, name).__doc__


def test_a_name_that_is_not_there_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'tunes'"):
        fopid.tunes  # noqa: B018


def test_the_version_is_that_of_the_package() -> None:
    manifest = Path(__file__).parents[3] / "src/fopid_core/package.xml"
    assert f"<version>{fopid.__version__}</version>" in manifest.read_text()


def test_five_lines_after_the_import_lead_from_a_plant_to_a_compared_plot(tmp_path: Path) -> None:
    """The lines of the package's own docstring, as they stand."""
    lines = [line.strip() for line in (fopid.__doc__ or "").splitlines() if line.startswith("    ")]
    assert lines[0] == "import fopid_core as fopid"
    assert len([line for line in lines[1:] if line]) == 5
    names: dict[str, object] = {}
    exec("\n".join(lines), names)
    figure = names["figure"]
    curves = {line.get_label(): line.get_ydata() for line in figure.axes[0].lines}  # type: ignore[attr-defined]
    assert set(curves) == {"PID", "FOPID"}
    assert all(curve[-1] == pytest.approx(1.0, abs=0.02) for curve in curves.values())
    figure.savefig(tmp_path / "compared.png")  # type: ignore[attr-defined]
    assert (tmp_path / "compared.png").stat().st_size > 10_000


def test_text_objects_and_python_control_are_one_process() -> None:
    delay_free = control.tf([2], [1, 3, 3, 1])
    answers = {
        fopid.margins(process, GAINS).phase_margin
        for process in ("2/(s+1)^3", fopid.read_process("2/(s+1)^3"), delay_free)
    }
    assert len({round(answer, 9) for answer in answers}) == 1


def test_a_controller_is_text_numbers_an_object_or_the_result_of_a_tuning() -> None:
    tuned = fopid.tune(PLANT, phase_margin_deg=60, crossover=0.4)
    assert tuned.controller is not None
    for controller in (tuned, tuned.controller, tuned.controller.gains, ",".join(map(repr, tuned.controller.gains))):
        assert math.degrees(fopid.margins(PLANT, controller).phase_margin) == pytest.approx(60.0, abs=1e-6)


def test_a_phase_margin_of_sixty_radians_is_answered_with_what_was_meant() -> None:
    with pytest.raises(fopid.InputError, match=r"60 degrees are 1.047 rad, phase_margin_deg"):
        fopid.tune(PLANT, phase_margin=60)
    with pytest.raises(fopid.InputError, match="one of them"):
        fopid.tune(PLANT, phase_margin=1.0, phase_margin_deg=60)


def test_degrees_and_radians_ask_for_the_same() -> None:
    degrees = fopid.tune(PLANT, phase_margin_deg=60, crossover=0.4)
    radians = fopid.tune(PLANT, "frequency", phase_margin=math.pi / 3, crossover=0.4)
    assert degrees.controller == radians.controller
    assert degrees.achieved is not None
    assert degrees.achieved.phase_margin_deg == pytest.approx(60.0)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: fopid.tune(PLANT, phasemargin=1.0), "did you mean phase_margin"),
        (lambda: fopid.simulate("P1", GAINS, contol_max=1.0), "did you mean control_max"),
        (lambda: fopid.front("P1", ms_maxx=2.0), "ms_maxx is no argument here; did you mean ms_max"),
        (lambda: fopid.limit("P1", msmax=2.0), "msmax is no argument here; did you mean ms_max"),
        (lambda: fopid.tune("P1", ms_max="1.6"), "ms_max = '1.6'; allowed: a number"),  # type: ignore[arg-type]
        (lambda: fopid.tune("P1", phase_margin_deg="60"), "phase_margin_deg = '60'; allowed: a number"),
        (lambda: fopid.margins("P1"), "no controller"),
        (lambda: fopid.margins(3.0, GAINS), "process of type float"),  # type: ignore[arg-type]
        (lambda: fopid.margins("P1", [1, 2, 3, 1, 1, 7]), "kp, ki, kd, lam, mu"),
        (lambda: fopid.margins("P1", object()), "kp, ki, kd, lam, mu"),  # type: ignore[arg-type]
        (lambda: fopid.identify(), "time, control and measurement"),
        (lambda: fopid.identify(time=[0, 1]), "control is not given"),
        (
            lambda: fopid.identify(time=[0], control=[0], measurement=[0], columns="a,b"),
            "columns = 'a,b' without a file",
        ),
        (lambda: fopid.simulate("P1", GAINS, horizon=-1.0), "horizon = -1"),
        (lambda: fopid.simulate("P1", GAINS, sample_time=0.0), "sample_time = 0"),
    ],
)
def test_what_cannot_be_used_is_named(call: object, said: str) -> None:
    with pytest.raises(fopid.InputError, match=said):
        call()  # type: ignore[operator]


@pytest.mark.slow
def test_the_method_follows_from_what_is_asked_for() -> None:
    assert fopid.tune("P1", crossover=0.3).method == "frequency"
    assert fopid.tune("P1", rule="amigo-pid").method == "rule"
    assert fopid.tune("P1", index="itae").method == "time"


def test_a_process_times_a_controller_is_a_loop() -> None:
    process, controller = fopid.read_process("P1"), fopid.Fopid(2.0, 1.0)
    for loop in (process * controller, controller * process):
        assert isinstance(loop, fopid.Loop)
        assert complex(loop(0.5j)) == pytest.approx(complex(process(0.5j) * controller(0.5j)))


def test_a_process_is_computed_with_like_a_number() -> None:
    process = fopid.read_process("1/(s+1)")
    s = np.array([0.3j, 2 + 1j])
    assert (2 * process / 4 + process * process - 1)(s) == pytest.approx(process(s) / 2 + process(s) ** 2 - 1)
    with pytest.raises(TypeError):
        process * "P1"  # type: ignore[operator]


def test_what_is_shown_is_short_and_reads_back() -> None:
    process = fopid.read_process(PLANT)
    assert eval(repr(process), {"Process": fopid.Process}) == process  # noqa: S307
    response, trace = fopid.step_response(PLANT, GAINS), fopid.simulate(PLANT, GAINS, 5.0)
    tuned = fopid.tune(PLANT, crossover=0.4)
    for value in (process, process * fopid.Fopid(1.0), response, trace, tuned):
        assert len(repr(value)) < 160
    assert "success" in repr(tuned)


def test_notebooks_get_html_and_formulas() -> None:
    process, tuned = fopid.read_process("1/(0.8s^2.2+1)*exp(-0.5s)"), fopid.tune(PLANT, crossover=0.4)
    assert process._repr_latex_() == r"$\dfrac{1}{0.8 s^{2.2} + 1}\,e^{-0.5s}$"
    for value in (fopid.Fopid(1.0), tuned, tuned.achieved, fopid.margins("P1", GAINS)):
        assert value._repr_html_().startswith("<table>")  # type: ignore[union-attr]
    assert "phase_margin_deg" in tuned._repr_html_()


def test_reduction_gives_the_simplest_of_the_nearest_or_the_one_asked_for() -> None:
    assert fopid.reduce("1/(2s+1)*exp(-s)").parameters == pytest.approx({"K": 1.0, "T": 2.0, "L": 1.0}, rel=1e-3)
    assert fopid.reduce("P1", "soptd").template == "soptd"


def test_identification_takes_a_file_a_record_or_arrays(tmp_path: Path) -> None:
    time = np.arange(0.0, 20.0, 0.05)
    step, answer = np.ones(400), 2.0 - 2.0 * np.exp(-time)
    np.savetxt(tmp_path / "step.csv", np.column_stack([time, step, answer]), delimiter=",",
               header="time,control,measurement", comments="")  # fmt: skip
    record = fopid.read_record(tmp_path / "step.csv", control_before=0.0)
    for found in (
        fopid.identify(record, template="foptd"),
        fopid.identify(tmp_path / "step.csv", template="foptd", control_before=0.0),
        fopid.identify(time=time, control=step, measurement=answer, template="foptd"),
    ):
        assert found.best is not None
        assert found.best.parameters["T"] == pytest.approx(1.0, rel=1e-3)


def test_a_simulation_keeps_the_limits_and_nears_the_exact_response() -> None:
    trace = fopid.simulate(PLANT, GAINS, 20.0, delay_model="exact")
    exact = fopid.step_response(PLANT, GAINS, 20.0, points=trace.time.size)
    assert float(np.abs(trace.measurement - exact.output).max()) < 0.02
    limited = fopid.simulate(PLANT, GAINS, 20.0, control_max=0.5, noise_std=0.01, seed=1)
    assert limited.control.max() <= 0.5
    assert len(trace.plot().axes) == 2
    assert len(limited.plot(trace.plot(), label="limited").axes[0].lines) == 3


def test_a_process_goes_to_python_control_and_back() -> None:
    process = fopid.read_process("3/((s+1)(s+2))")
    there = fopid.to_transfer_function(process)
    assert fopid.from_control(there)(1j) == pytest.approx(process(1j))


def test_filter_and_setpoint_weights_of_a_design_come_into_the_loop_and_into_the_simulation() -> None:
    found = fopid.tune(PLANT, rule="simc-pi")
    design = replace(found, filter=MeasurementFilter(1, 0.3), weights=SetpointWeights(0.2, 0.0))
    assert found.controller is not None
    assert fopid.margins(PLANT, design).ms > fopid.margins(PLANT, found).ms + 0.05
    exact = fopid.step_response(PLANT, design, 20.0, points=2001).output
    bare = fopid.simulate(PLANT, found, 20.0, delay_model="exact").measurement
    assert float(np.abs(fopid.simulate(PLANT, design, 20.0, delay_model="exact").measurement - exact).max()) < 0.01
    assert float(np.abs(bare - exact).max()) > 0.05
