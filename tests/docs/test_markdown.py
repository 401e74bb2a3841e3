"""The runner of the documentation fails where a page is wrong."""

from __future__ import annotations

from pathlib import Path

import pytest

from .markdown import blocks, run, stands_in

PAGE = """\
# A page

Write `settings.yaml`:

```yaml
kp: 1
```

```sh
cat settings.yaml
```

```text
kp:   1.01
```
"""


def written(folder: Path, text: str) -> Path:
    page = folder / "page.md"
    page.write_text(text)
    return page


def test_files_are_written_and_what_is_printed_is_compared(tmp_path: Path) -> None:
    assert run(written(tmp_path, PAGE), tmp_path) == "kp: 1\n"


@pytest.mark.parametrize(
    "change", [("kp:   1.01", "kp: 1.5"), ("cat settings.yaml", "cat other.yaml"), ("kp: ", "ki: ")]
)
def test_a_page_that_does_not_hold_what_it_says_fails(change: tuple[str, str], tmp_path: Path) -> None:
    wrong = PAGE.replace(*change, 1) if change[0] != "kp: " else PAGE.replace("kp:   1.01", "ki: 1.01")
    with pytest.raises(AssertionError):
        run(written(tmp_path, wrong), tmp_path)


def test_a_command_that_ends_too_soon_fails_and_one_that_runs_on_is_ended(tmp_path: Path) -> None:
    page = "Start it and leave it running:\n\n```sh\n{}\n```\n"
    with pytest.raises(AssertionError):
        run(written(tmp_path, page.format("false")), tmp_path)
    run(written(tmp_path, page.format("sleep 1000")), tmp_path)


def test_python_blocks_are_one_program(tmp_path: Path) -> None:
    page = "```python\nx = 1\n```\n\n```python\nprint(x + 1)\n```\n"
    assert [block.kind for block in blocks(page)] == ["python", "python"]
    assert run(written(tmp_path, page), tmp_path) == "2\n"


def test_numbers_may_differ_by_two_per_cent() -> None:
    assert stands_in("ms  1.22", "  ms   1.2204\n")
    assert not stands_in("ms  1.22", "  ms   1.3\n")
    assert not stands_in("ms  1.22", "  mt   1.22\n")
