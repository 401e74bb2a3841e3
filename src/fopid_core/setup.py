from pathlib import Path
from xml.etree import ElementTree as ET

from setuptools import find_packages, setup

manifest = ET.parse(Path(__file__).with_name("package.xml")).getroot()
name = manifest.findtext("name")

# What asks for which is in fopid_core/cli/extras.py. The lower bounds are what Ubuntu 24.04 ships.
YAML = "pyyaml>=6.0,<7"
EXTRAS = {
    "plots": ["matplotlib>=3.6", "plotly>=5.15"],
    "experiments": [YAML],
    "bags": [
        "apsw",
        'backports.zstd; python_version < "3.14"',
        "lz4",
        "mcap>=1.2",
        YAML,
        "rosbags>=0.11",
        "zstandard>=0.22",
    ],
    "campaigns": ["distributed", "pyarrow>=20", YAML],
    "control": ["control>=0.10"],
    "certify": ["python-flint"],
    "explore": ["tornado>=6.4,<7"],
    "limit": ["clarabel", "cvxpy-base>=1.4"],
    "benchmark": ["clarabel", "control>=0.10", "cvxpy-base>=1.4", "pyarrow>=20", "simple-pid"],
    "test": ["hypothesis", "mpmath", "pytest"],
}

setup(
    name=name,
    version=manifest.findtext("version"),
    description=manifest.findtext("description"),
    license=manifest.findtext("license"),
    python_requires=">=3.11",
    packages=find_packages(include=[name, f"{name}.*"]),
    package_data={
        "": ["*.lark", "*.json", "*.yaml", "*.html", "*.css", "*.js", "*.h", "*.c", "py.typed"],
        f"{name}.study.page": ["static/*.*", "static/uplot/*"],
        f"{name}.study.explore": ["static/*.*"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{name}"]),
        (f"share/{name}", ["package.xml"]),
    ],
    zip_safe=False,
    install_requires=["click>=8.1,<9", "lark>=1.1,<2", "numpy>=1.26,<3", "scipy>=1.11,<2"],
    extras_require={**EXTRAS, "all": sorted({each for extra in EXTRAS.values() for each in extra})},
    entry_points={"console_scripts": ["fopid = fopid_core.cli.main:main"]},
)
