"""Installation of icreckon_ros by colcon."""

from setuptools import setup

NAME = "icreckon_ros"

setup(
    name=NAME,
    version="0.3.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/icreckon.launch.py"]),
        (f"share/{NAME}/config", ["config/icreckon.yaml"]),
    ],
    zip_safe=True,
    extras_require={"test": ["pytest"]},
    description="Launch file and entry point of icreckon's ROS 2 node",
    license="Apache-2.0",
    entry_points={"console_scripts": [f"odometry = {NAME}.node:main"]},
)
