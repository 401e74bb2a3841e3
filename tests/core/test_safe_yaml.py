"""YAML that would fill the memory or the stack is refused in one line before anything is made of it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from fopid_core import safe_yaml
from fopid_core.errors import InputError
from fopid_core.model.process import read_process
from fopid_core.study.campaigns.campaign import read_campaign
from fopid_core.study.experiments.experiment import read_experiment

TENFOLD = "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]\n" for i in range(1, 10)
)
MERGED = "a0: &a0 {k: 1, l: 2}\n" + "".join(
    f"a{i}: &a{i} {{<<: [{', '.join([f'*a{i - 1}'] * 10)}]}}\n" for i in range(1, 10)
)
BOMBS = {
    "aliases": TENFOLD,
    "merges": MERGED,
    "brackets": "[" * 100_000,
    "braces": "{a: " * 100_000,
    "dashes": "- " * 100_000 + "x",
    "itself": "a: &a [*a]",
    "digits": "a: " + "1" * 100_000,
    "bytes": "a: \x00",
}
READERS = {"process": read_process, "campaign": read_campaign, "experiment": read_experiment}


@pytest.mark.parametrize("bomb", BOMBS)
@pytest.mark.parametrize("reader", READERS)
def test_every_reader_refuses_it_in_one_line(reader: str, bomb: str, tmp_path: Path) -> None:
    path = tmp_path / "file.yaml"
    path.write_text(BOMBS[bomb])
    with pytest.raises(InputError) as error:
        READERS[reader](str(path) if reader == "process" else path)  # type: ignore[operator]
    assert "file.yaml" in str(error.value)
    assert "\n" not in str(error.value)


def test_a_pipe_is_refused_and_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.yaml")
    with pytest.raises(InputError, match="it is no file"):
        read_process(str(tmp_path / "pipe.yaml"))


def test_a_file_that_is_too_large_is_not_read(tmp_path: Path) -> None:
    with (tmp_path / "large.yaml").open("wb") as file:
        file.truncate(safe_yaml.MOST_BYTES + 1)
    with pytest.raises(InputError, match="more than 50,000,000 bytes"):
        read_process(str(tmp_path / "large.yaml"))


def test_what_is_refused_has_cost_little_memory() -> None:
    code = (
        "import resource; resource.setrlimit(resource.RLIMIT_AS, (2**30, 2**30))\n"
        "import sys; from fopid_core import safe_yaml\n"
        "try: safe_yaml.load(sys.stdin.read())\n"
        "except ValueError as error: print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], input=TENFOLD, capture_output=True, text=True)
    assert "more than 3,000,000 values" in done.stdout, done.stderr


@pytest.mark.parametrize("depth", [1, 62, 63])
def test_what_is_within_the_limits_is_what_yaml_reads(depth: int) -> None:
    text = f"a: &a [1, 2.5, x]\nb: {{<<: {{c: 1}}, d: *a}}\ne: {'[' * depth}{']' * depth}\n"
    assert safe_yaml.load(text) == yaml.safe_load(text)
