"""A campaign's file, and the runs it makes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.study.campaigns.campaign import RUNS_AT_ONCE, Campaign, Design, Range, Variations, read_campaign
from fopid_core.study.experiments.tune_call import TuneCall
from fopid_core.study.experiments.yaml_schema import bind
from fopid_core.study.verdict.survey import is_survey, read_survey

CAMPAIGNS = Path(__file__).parents[4] / "config" / "campaigns"
TEXT = """\
name: small
processes: [P1, "2/(s+1)^2*exp(-0.2s)"]
variations:
  gain: [0.5, 2]
  delay: {low: 0, high: 0.3}
  samples: 3
designs:
  - {name: known, only: [P1], gains: {kp: 1, ki: 0.3}}
  - {name: tuned, method: frequency, phase_margin_deg: [50, 60], crossover: 0.3}
figure: [ms]
"""


def read(tmp_path: Path, text: str) -> Campaign:
    path = tmp_path / "campaign.yaml"
    path.write_text(text)
    return read_campaign(path)


def test_designs_processes_specifications_and_variations_multiply(tmp_path: Path) -> None:
    campaign = read(tmp_path, TEXT)
    found = [(group.process, group.design, group.controller) for group in campaign.groups]
    delayed = "2/(s+1)^2*exp(-0.2s)"
    fifty, sixty = (TuneCall("frequency", phase_margin_deg=m, crossover=0.3) for m in (50.0, 60.0))
    assert found == [("P1", "known", Fopid(1.0, 0.3)), ("P1", "tuned", fifty), ("P1", "tuned", sixty),
                     (delayed, "tuned", fifty), (delayed, "tuned", sixty)]  # fmt: skip
    assert campaign.runs == 5 * (1 + 2 * 3)
    assert bind(Campaign, yaml.safe_load(campaign.to_yaml())) == campaign


@pytest.mark.parametrize(
    ("old", "new", "line", "named"),
    [
        ("[P1, ", "[P1, '1/(s+', ", 2, "processes[1]: process text '1/(s+'"),
        ("gain: [0.5, 2]", "gain: [-1, 2]", 4, "gain = [-1.0, 2.0]; allowed: factors of one sign"),
        ("gain: [0.5, 2]", "gain: []", 4, "at least one"),
        ("low: 0,", "low: -1,", 5, "delay = -1.0; allowed: 0 s or more"),
        ("{low: 0, high: 0.3}", "{low: 1, high: 0}", 5, "the lower one first"),
        ("high: 0.3}", "high: 0.3, distribution: normal}", 5, "allowed: uniform, loguniform"),
        ("high: 0.3}", "high: 0.3, distribution: loguniform}", 5, "low = 0.0; allowed: above 0"),
        ("samples: 3", "samples: 0", 6, "samples = 0"),
        ("samples: 3", "sampels: 3", 6, "did you mean 'samples'?"),
        ("only: [P1]", "only: [P2]", 8, "only = 'P2'"),
        ("kp: 1,", "kp: 1, lam: 3,", 8, "lam = 3.0"),
        ("method: frequency", "method: magic", 9, "method = 'magic'"),
        ("method: frequency, ", "", 9, "neither of gains and method"),
        ("[50, 60]", "[50, 260]", 9, "phase_margin_deg = 260.0"),
        ("[ms]", "[mss]", 10, "figure = 'mss'"),
    ],
)
def test_what_cannot_be_run_is_named_with_its_line(tmp_path: Path, old: str, new: str, line: int, named: str) -> None:
    assert old in TEXT
    with pytest.raises(InputError) as error:
        read(tmp_path, TEXT.replace(old, new, 1))
    assert f", line {line}: " in str(error.value)
    assert named in str(error.value)


def test_the_first_variation_is_the_process_as_it_is_and_a_seed_repeats_the_others() -> None:
    variations = Variations(
        gain=Range(0.5, 2.0, "loguniform"), time_scale=(0.8, 1.2), delay=Range(0.0, 0.3), samples=500
    )
    table = variations.table()
    assert table[0].tolist() == [1.0, 1.0, 0.0]
    assert table.shape == (variations.count, 3) == (1001, 3)
    assert np.array_equal(table, variations.table())
    assert ((table[1:, 0] >= 0.5) & (table[1:, 0] <= 2.0)).all()
    assert abs(np.log(table[1:, 0]).mean()) < 4.0 * np.log(2.0) / np.sqrt(3.0 * 1000.0)  # 4 standard deviations
    assert sorted(set(table[1:, 1])) == [0.8, 1.2]
    assert abs(table[1:, 2].mean() - 0.15) < 4.0 * 0.3 / np.sqrt(12.0 * 1000.0)


def test_too_many_runs_are_refused_before_they_are_drawn() -> None:
    many = Variations(gain=(1.0,) * 1000, delay=Range(0.0, 1.0), samples=10_000_000)
    with pytest.raises(InputError, match="10,000,000,001 runs"):
        Campaign("c", ("P1",), (Design("a", gains={"kp": 1.0}),), many)


@settings(derandomize=True, deadline=None, max_examples=60)
@given(st.integers(1, 12), st.integers(1, 1300))
def test_tasks_hold_every_run_once_and_in_order(designs: int, samples: int) -> None:
    several = tuple(Design(f"{i}", gains={"kp": 1.0 + i}) for i in range(designs))
    campaign = Campaign("c", ("P1",), several, Variations(gain=Range(0.5, 2.0), samples=samples))
    tasks = list(campaign.tasks())
    runs = [(group, i) for task in tasks for group in task.groups for i in range(task.first, task.end)]
    assert runs == [(group, i) for group in range(designs) for i in range(samples + 1)]
    assert len({task.name for task in tasks}) == len(tasks)
    assert max(task.runs for task in tasks) <= max(RUNS_AT_ONCE, 1)
    assert sum(task.runs for task in tasks) == campaign.runs


@pytest.mark.parametrize("path", sorted(CAMPAIGNS.glob("*.yaml")), ids=lambda path: path.stem)
def test_shipped_campaigns_can_be_read(path: Path) -> None:
    assert (read_survey(path) if is_survey(path) else read_campaign(path)).runs > 0


def test_the_shipped_campaign_tries_a_thousand_variations_of_each_process_with_four_designs() -> None:
    campaign = read_campaign(CAMPAIGNS / "robustness.yaml")
    assert campaign.runs == 4 * 4 * 1001
