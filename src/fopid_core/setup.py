from pathlib import Path
from xml.etree import ElementTree as ET

from setuptools import find_packages, setup

manifest = ET.parse(Path(__file__).with_name("package.xml")).getroot()
name = manifest.findtext("name")

setup(
    name=name,
    version=manifest.findtext("version"),
    description=manifest.findtext("description"),
    license=manifest.findtext("license"),
    python_requires=">=3.11",
    packages=find_packages(include=[name, f"{name}.*"]),
    package_data={"": ["*.lark", "*.json", "*.yaml", "*.html", "*.css", "*.js", "*.h", "*.c", "py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{name}"]),
        (f"share/{name}", ["package.xml"]),
    ],
    zip_safe=False,
    install_requires=[
        "apsw",
        'backports.zstd; python_version < "3.14"',
        "click",
        "control",
        "lark",
        "matplotlib",
        "mcap",
        "numpy",
        "plotly",
        "pyarrow",
        "pyyaml",
        "rich",
        "rosbags",
        "scipy",
        "zstandard",
    ],
    extras_require={
        "certify": ["python-flint"],
        "cluster": ["distributed"],
        "test": ["hypothesis", "mpmath", "pytest"],
    },
    entry_points={"console_scripts": ["fopid = fopid_core.cli.main:main"]},
)
