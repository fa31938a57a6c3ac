"""Builds the package for colcon; panoloc's own pyproject.toml installs the same code as `panoloc.ros2`."""

from setuptools import setup

NAME = "panoloc_ros2"

setup(
    name=NAME,
    version="0.1.0",
    description="Gives a robot its place in a scanned building, by a panoloc service",
    license="Apache-2.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/panoloc.launch.py"]),
        (f"share/{NAME}/config", ["config/params.yaml"]),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    entry_points={"console_scripts": [f"panoloc = {NAME}.node:main"]},
)
