#!/usr/bin/env bash
# Build wheels and source distributions of the three packages, and try the wheels in an environment of their own.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
root=$PWD
out=$root/build/release
bin=$root/.venv/bin
export PATH=$bin:$PATH
rm -rf "$out"
mkdir -p "$out/dist"

for package in fopid_core fopid_ros; do
  cp -r "src/$package" "$out/$package"  # setuptools leaves its traces beside the sources
  rm -rf "$out/$package"/*.egg-info "$out/$package/build"
  (cd "$out/$package" && python -W ignore setup.py --quiet bdist_wheel --dist-dir "$out/dist" sdist --dist-dir "$out/dist") >"$out/$package.log" 2>&1 ||
    { tail -n 30 "$out/$package.log" >&2; exit 1; }
done
cp build/wheels/*/fopid_msgs-*.whl "$out/dist"

# An sdist is whole when the wheel that is made from it holds what the wheel from the tree holds.
for package in fopid_core fopid_ros; do
  mkdir "$out/again_$package"
  tar -xzf "$out"/dist/$package-*.tar.gz -C "$out/again_$package"
  (cd "$out/again_$package"/*/ && python -W ignore setup.py --quiet bdist_wheel --dist-dir "$out/again_$package") >>"$out/$package.log" 2>&1
  diff <(python -m zipfile -l "$out"/dist/$package-*.whl | awk '{ print $1 }' | grep -v 'RECORD$' | sort) \
    <(python -m zipfile -l "$out/again_$package"/$package-*.whl | awk '{ print $1 }' | grep -v 'RECORD$' | sort)
done

# Without ROS: the wheel and what it names, nothing else.
python -m venv "$out/plain"
"$out/plain/bin/python" -m pip install -qq --disable-pip-version-check "$out"/dist/fopid_core-*.whl matplotlib
(cd "$out" && "$out/plain/bin/fopid" step "1/(s+1)^3" --gains 1.2,0.5,0.7,1,1 --plot first.png >/dev/null)
test -s "$out/first.png"
installed=$("$out/plain/bin/python" -c 'import fopid_core; print(fopid_core.__version__)')

# With ROS: the pinned packages, and the three wheels over them.
python -m venv "$out/ros"
grep -v '^#\|^ ' requirements.txt | cut -d';' -f1 >"$out/pinned.txt"
uv pip install --quiet --python "$out/ros/bin/python" --no-deps -r "$out/pinned.txt" ||
  "$out/ros/bin/python" -m pip install -qq --disable-pip-version-check --no-deps -r "$out/pinned.txt"
uv pip install --quiet --python "$out/ros/bin/python" --no-deps "$out"/dist/*.whl
"$out/ros/bin/fopid_controller" --help >/dev/null
"$out/ros/bin/python" -c 'from fopid_msgs.srv import Tune; import fopid_ros.tuner.node'
for folder in launch config layouts; do
  test -n "$(ls "$out/ros/share/fopid_ros/$folder")"
done
echo "fopid $installed: $(ls "$out/dist" | tr '\n' ' ')"
