#!/usr/bin/env bash
# Build wheels and source distributions of the three packages, and try them in environments of their own: with each Python
# of PYTHONS that is found (of pyenv's, too); what is not found is said. With another Python than that of .venv the messages
# are built from their source distribution.
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
own=$(python -c 'import sys; print("3.%d" % sys.version_info[1])')
wheel=$(ls -t build/wheels/*/fopid_msgs-*.whl | head -n 1)
cp "$wheel" "$out/dist"
uv build --quiet --sdist --no-build-isolation --python "$bin/python" --out-dir "$out/dist" src/fopid_msgs
# Nothing of the package is missing in its source distribution.
diff <(cd src/fopid_msgs && git ls-files | sort) \
  <(tar -tzf "$out"/dist/fopid_msgs-*.tar.gz | cut -d/ -f2- | grep -v '^PKG-INFO$' | sort)

# An sdist is whole when the wheel that is made from it holds what the wheel from the tree holds.
for package in fopid_core fopid_ros; do
  mkdir "$out/again_$package"
  tar -xzf "$out"/dist/$package-*.tar.gz -C "$out/again_$package"
  (cd "$out/again_$package"/*/ && python -W ignore setup.py --quiet bdist_wheel --dist-dir "$out/again_$package") >>"$out/$package.log" 2>&1
  diff <(python -m zipfile -l "$out"/dist/$package-*.whl | awk '{ print $1 }' | grep -v 'RECORD$' | sort) \
    <(python -m zipfile -l "$out/again_$package"/$package-*.whl | awk '{ print $1 }' | grep -v 'RECORD$' | sort)
done

# Without ROS: the wheel and what it names, nothing else.
plain() { # python, folder
  "$1" -m venv "$2"
  "$2/bin/python" -m pip install -qq --disable-pip-version-check "$out"/dist/fopid_core-*.whl matplotlib
  (cd "$out" && "$2/bin/fopid" step "1/(s+1)^3" --gains 1.2,0.5,0.7,1,1 --plot "$2/first.png" >/dev/null)
  test -s "$2/first.png"
}

# With ROS: the pinned packages, and the three wheels over them.
with_ros() { # python, folder, wheel of the messages
  "$1" -m venv "$2"
  uv pip install --quiet --python "$2/bin/python" --no-deps -r "$out/pinned.txt" ||
    "$2/bin/python" -m pip install -qq --disable-pip-version-check --no-deps -r "$out/pinned.txt"
  uv pip install --quiet --python "$2/bin/python" --no-deps "$out"/dist/fopid_{core,ros}-*.whl "$3"
  "$2/bin/fopid_controller" --help >/dev/null
  "$2/bin/python" -c 'from fopid_msgs.srv import Tune; import fopid_ros.tuner.node'
  local shared
  for shared in launch config layouts; do
    test -n "$(ls "$2/share/fopid_ros/$shared")"
  done
}

# The wheel of the messages for another Python, from the source distribution.
messages() { # python, folder
  "$1" -m venv "$2/build"
  grep -v '^#\|^ ' requirements-dev.txt | cut -d';' -f1 >"$2/dev.txt"
  uv pip install --quiet --python "$2/build/bin/python" --no-deps -r "$2/dev.txt" ||
    "$2/build/bin/python" -m pip install -qq --disable-pip-version-check --no-deps -r "$2/dev.txt"
  PATH=$2/build/bin:$PATH uv build --quiet --wheel --no-build-isolation --python "$2/build/bin/python" \
    --out-dir "$2" "$out"/dist/fopid_msgs-*.tar.gz
}

find_python() { # 3.12
  local candidate
  for candidate in "python$1" "${PYENV_ROOT:-$HOME/.pyenv}"/versions/"$1".*/bin/python; do
    "$candidate" -c "import sys; sys.exit('3.%d' % sys.version_info[1] != '$1')" 2>/dev/null && command -v "$candidate" && return
  done
  return 1
}

grep -v '^#\|^ ' requirements.txt | cut -d';' -f1 >"$out/pinned.txt"
for version in ${PYTHONS:-$own}; do
  if ! python=$(find_python "$version"); then
    echo "Python $version: not found, not tried"
    continue
  fi
  folder=$out/python$version
  mkdir "$folder"
  plain "$python" "$folder/plain"
  if [ "$version" = "$own" ]; then
    messages=$wheel
  else
    messages "$python" "$folder"
    messages=$(ls "$folder"/fopid_msgs-*.whl)
  fi
  with_ros "$python" "$folder/ros" "$messages"
  installed=$("$folder/plain/bin/python" -c 'import fopid_core; print(fopid_core.__version__)')
  echo "Python $version: fopid $installed runs, with ROS and without"
done
ls "$out/dist" | tr '\n' ' '
echo
