#!/usr/bin/env bash
# Build and test the tree as a colcon workspace against the ROS 2 in .venv, then check what was installed.
# On a machine with ROS 2 Jazzy a plain `colcon build` does the same.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
root=$PWD
out=$root/build/colcon

export PATH=$root/.venv/bin:$PATH
export AMENT_PREFIX_PATH=$root/.venv CMAKE_PREFIX_PATH=$root/.venv ROS_DISTRO=jazzy

bases=(--base-paths src --build-base "$out/build" --install-base "$out/install")
log=(--log-base "$out/log")
quiet=(--event-handlers 'desktop_notification-' 'terminal_title-')

rm -rf "$out"
colcon "${log[@]}" build "${bases[@]}" "${quiet[@]}" \
  --cmake-args "-DCMAKE_PROJECT_INCLUDE=$root/src/fopid_msgs/cmake/ros_from_pypi.cmake" -DCMAKE_BUILD_TYPE=Release
colcon "${log[@]}" test "${bases[@]}" "${quiet[@]}" --return-code-on-test-failure ||
  { colcon "${log[@]}" test-result --test-result-base "$out/build" --verbose; exit 1; }
colcon "${log[@]}" test-result --test-result-base "$out/build"

# The settings of colcon lead every process from here on: setup.bash wants unset variables.
set +u
source "$out/install/setup.bash"
set -u
python -m pytest -m colcon tests/workspace
