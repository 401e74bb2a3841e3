from pathlib import Path
from xml.etree import ElementTree as ET

from setuptools import find_packages, setup

from distutils.command.install_data import install_data  # isort: skip  (setuptools provides it)

EXECUTABLES = {
    "plant_simulator": "plant.node",
    "fopid_controller": "controller.node",
    "fopid_loops": "controller.loops",
    "fopid_tuner": "tuner.node",
    "autotune": "tuner.autotune_command",
    "experiment": "experiment.command",
    "dashboard": "dashboard.main",
    "fopid_demo": "experiment.demo",
    "fopid_ros_benchmark": "benchmarks.benchmark",
}

manifest = ET.parse(Path(__file__).with_name("package.xml")).getroot()
name = manifest.findtext("name")


class InstallData(install_data):
    """Also puts each executable where `ros2 run` and launch look for it.

    colcon puts the scripts into lib/<package> (setup.cfg), pip only into bin.
    """

    def run(self):
        super().run()
        folder = Path(self.install_dir, "lib", name)
        folder.mkdir(parents=True, exist_ok=True)
        for executable in EXECUTABLES:
            script = folder / executable
            if not script.exists():
                script.write_text(f'#!/bin/sh\nexec "${{0%/*}}/../../bin/{executable}" "$@"\n')
                script.chmod(0o755)
                self.outfiles.append(str(script))


def shared(folder, pattern):
    """Return the data_files entries that keep the tree of `folder` under share/."""
    files = [path for path in sorted(Path(folder).rglob(pattern)) if path.is_file()]
    return [(f"share/{name}/{path.parent}", [str(path)]) for path in files]


setup(
    name=name,
    version=manifest.findtext("version"),
    description=manifest.findtext("description"),
    license=manifest.findtext("license"),
    python_requires=">=3.11",
    packages=find_packages(include=[name, f"{name}.*"]),
    package_data={"": ["py.typed", "*.yaml", "*.xml"], f"{name}.dashboard": ["static/*.*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{name}"]),
        (f"share/{name}", ["package.xml"]),
        *shared("launch", "*.launch.*"),
        *shared("config", "*.*"),
        *shared("layouts", "*.*"),
    ],
    zip_safe=False,
    # What comes with ROS 2 (rclpy, the messages) is in package.xml.
    install_requires=[
        "fopid_core[experiments,explore]",
        "numpy>=1.26,<3",
        "pyyaml>=6.0,<7",
        "rich>=13.7",
        "tornado>=6.4,<7",
    ],
    extras_require={"bags": ["fopid_core[bags,plots]"], "test": ["pytest"]},
    entry_points={
        "console_scripts": [f"{executable} = {name}.{module}:main" for executable, module in EXECUTABLES.items()]
    },
    cmdclass={"install_data": InstallData},
)
