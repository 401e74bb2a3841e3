"""What `colcon build` installs is complete, and is what runs once its setup.bash is sourced."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.colcon

ROOT = Path(__file__).parents[2]
INSTALL = ROOT / "build" / "colcon" / "install"
PACKAGES = ("fopid_core", "fopid_msgs", "fopid_ros")
EXECUTABLES = (
    "autotune",
    "dashboard",
    "experiment",
    "fopid_controller",
    "fopid_demo",
    "fopid_loops",
    "fopid_ros_benchmark",
    "fopid_tuner",
    "plant_simulator",
)


def tree(folder: Path, pattern: str) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob(pattern) if path.is_file()}


@pytest.mark.parametrize("package", PACKAGES)
def test_package_is_in_the_ament_index(package):
    share = INSTALL / package / "share"
    assert (share / "ament_index" / "resource_index" / "packages" / package).is_file()
    assert (share / package / "package.xml").is_file()


@pytest.mark.parametrize("package", PACKAGES)
def test_sourced_environment_finds_the_package_in_the_workspace(package):
    from ament_index_python.packages import get_package_prefix

    assert Path(get_package_prefix(package)) == INSTALL / package


@pytest.mark.parametrize("package", PACKAGES)
def test_sourced_python_imports_the_package_from_the_workspace(package):
    command = [sys.executable, "-c", f"import {package}; print({package}.__file__)"]
    run = subprocess.run(command, cwd=INSTALL, capture_output=True, text=True, check=True)
    assert Path(run.stdout.strip()).is_relative_to(INSTALL / package)


@pytest.mark.parametrize("executable", EXECUTABLES)
def test_executable_is_where_ros2_run_looks_and_shows_its_help(executable):
    script = INSTALL / "fopid_ros" / "lib" / "fopid_ros" / executable
    assert os.access(script, os.X_OK)
    run = subprocess.run([script, "--help"], cwd=INSTALL, capture_output=True, text=True, timeout=60)
    assert run.returncode == 0, run.stderr
    assert "usage" in run.stdout.lower()


def test_command_fopid_shows_its_help():
    script = INSTALL / "fopid_core" / "lib" / "fopid_core" / "fopid"
    run = subprocess.run([script, "--help"], cwd=INSTALL, capture_output=True, text=True, timeout=60)
    assert run.returncode == 0, run.stderr
    assert "usage" in run.stdout.lower()


def test_launch_files_are_installed():
    installed = tree(INSTALL / "fopid_ros" / "share" / "fopid_ros" / "launch", "*")
    assert installed == tree(ROOT / "src" / "fopid_ros" / "launch", "*.launch.*")
    assert installed


def test_configuration_is_installed_as_it_stands_in_the_repository():
    installed = tree(INSTALL / "fopid_ros" / "share" / "fopid_ros" / "config", "*")
    assert installed == tree(ROOT / "config", "*.*")
    assert installed


def test_data_files_of_the_core_are_installed():
    site = next((INSTALL / "fopid_core").glob("lib/python*/site-packages")) / "fopid_core"
    source = ROOT / "src" / "fopid_core" / "fopid_core"
    for pattern in ("*.lark", "*.json", "*.yaml", "*.html", "*.css", "*.js", "py.typed"):
        assert tree(site, pattern) == tree(source, pattern)


@pytest.mark.parametrize("executable", EXECUTABLES)
def test_pip_environment_has_the_same_executables(executable):
    prefix = Path(sys.prefix)
    assert os.access(prefix / "bin" / executable, os.X_OK)
    assert os.access(prefix / "lib" / "fopid_ros" / executable, os.X_OK)


def test_every_interface_is_shown_to_the_workspace():
    share = INSTALL / "fopid_msgs" / "share" / "fopid_msgs"
    source = ROOT / "src" / "fopid_msgs"
    for kind in ("msg", "srv"):
        assert tree(source / kind, f"*.{kind}") <= tree(share / kind, f"*.{kind}")
    assert shutil.which("fopid")
