#!/usr/bin/env bash
# make_venv.sh [.venv | .venv-jazzy]: make it, or bring it up to date; does nothing when it is.
#
# .venv has today's libraries (requirements-dev.txt), .venv-jazzy those of Ubuntu 24.04 (requirements-jazzy.txt).
# The stamp .complete in it is written last and removed first, and holds a checksum of everything the
# environment is made from. Without a stamp an environment is half-finished: it is thrown away.
set -euo pipefail
shopt -s globstar nullglob
cd "$(dirname "${BASH_SOURCE[0]}")/.."
root=$PWD
name=${1:-.venv}
venv=$root/$name
stamp=$venv/.complete
case $name in
  .venv) lock=requirements-dev.txt wheels=build/wheels wanted=${PYTHON:-python3.11} ;;
  .venv-jazzy) lock=requirements-jazzy.txt wheels=build/wheels-jazzy wanted=python3.12 ;;
  *) echo "make venv: environment '$name'; allowed: .venv, .venv-jazzy" >&2 && exit 2 ;;
esac
shared_files=(src/fopid_ros/launch/*.launch.* src/fopid_ros/config/**/*.yaml src/fopid_ros/layouts/*)
mkdir -p build

say() { printf '[%s] %s\n' "${name#.}" "$*"; }

choose_python() {
  local candidate
  for candidate in "$wanted" "${PYENV_ROOT:-$HOME/.pyenv}"/versions/"${wanted#python}".*/bin/"$wanted" \
    python3 python3.12 python3.13; do
    if "$candidate" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null; then
      if [[ $name = .venv-jazzy && $("$candidate" --version) != 'Python 3.12.'* ]]; then
        say "no Python 3.12 as on Ubuntu 24.04 was found; its libraries are tried with $("$candidate" --version)" >&2
      fi
      command -v "$candidate"
      return
    fi
  done
  echo 'make venv: needs Python 3.11 (3.12 and 3.13 are accepted); set PYTHON=/path/to/python3.11' >&2
  return 1
}

# Everything the wheel of fopid_msgs is made from.
msgs_inputs() {
  "$1" -VV
  grep -E '^ros-|^numpy=' "$lock"
  find src/fopid_msgs -type f -not -path '*/__pycache__/*' -print0 | sort -z | xargs -0 sha256sum
}

# Everything the environment is made from. Of launch and configuration files only the names: they are links.
venv_inputs() {
  echo "$root"
  msgs_inputs "$1"
  sha256sum "$lock" tools/make_venv.sh src/fopid_{core,ros}/{package.xml,setup.py,setup.cfg}
  printf '%s\n' "${shared_files[@]}"
}

checksum() { sha256sum | cut -d' ' -f1; }

build_msgs() {
  local folder
  folder=$wheels/$(msgs_inputs "$venv/bin/python" | checksum)
  if ! compgen -G "$folder/*.whl" >/dev/null; then
    say 'building fopid_msgs (messages and services; about half a minute)'
    rm -rf "$wheels"
    mkdir -p "$wheels"
    if ! PATH=$venv/bin:$PATH "$venv/bin/uv" build --wheel --no-build-isolation \
      --python "$venv/bin/python" --out-dir "$wheels/new" src/fopid_msgs >build/fopid_msgs.log 2>&1; then
      tail -n 40 build/fopid_msgs.log >&2
      echo 'make venv: fopid_msgs did not build; the whole output is in build/fopid_msgs.log' >&2
      return 1
    fi
    mv "$wheels/new" "$folder"
  fi
  wheel=$(compgen -G "$folder/*.whl")
}

install_locked() {
  local uv_pin
  uv_pin=$(grep '^uv==' "$lock")
  "$venv/bin/python" -m pip install -qq --disable-pip-version-check "$uv_pin"
  say "installing $(grep -c == "$lock") pinned packages"
  # Without their dependencies: the lock is complete; asked for them, an installer would bring back what it leaves out.
  grep -v '^matplotlib==3\.6\.' "$lock" >"$venv/pinned.txt"
  install_pinned -r "$venv/pinned.txt"
  if grep -q '^matplotlib==3\.6\.' "$lock"; then
    install_old_matplotlib
  fi
}

# uv does not read pip's configuration; where packages come from a mirror, pip does it.
install_pinned() {
  "$venv/bin/uv" pip install --quiet --python "$venv/bin/python" --no-deps "$@" ||
    "$venv/bin/python" -m pip install -qq --disable-pip-version-check --no-deps "$@"
}

# Ubuntu 24.04 builds matplotlib 3.6 for Python 3.12 itself, PyPI has no wheel of it.
install_old_matplotlib() {
  local folder=build/wheels-matplotlib
  if ! compgen -G "$folder/*.whl" >/dev/null; then
    say 'building matplotlib (about a minute)'
    printf '[libs]\nsystem_freetype = true\nsystem_qhull = true\n' >build/matplotlib.cfg
    if ! MPLSETUPCFG=$root/build/matplotlib.cfg "$venv/bin/python" -m pip wheel --no-deps --no-build-isolation \
      --no-binary matplotlib --wheel-dir "$folder" "$(grep -o '^matplotlib==[0-9.]*' "$lock")" >build/matplotlib.log 2>&1; then
      tail -n 20 build/matplotlib.log >&2
      echo 'make venv: matplotlib did not build; it needs g++, pkg-config and the packages libfreetype-dev and libqhull-dev' >&2
      return 1
    fi
  fi
  install_pinned "$folder"/matplotlib-*.whl
}

install_project() {
  say 'installing fopid_msgs, fopid_core and fopid_ros (the last two editable)'
  printf '%s\n' "$wheel" '-e src/fopid_core' '-e src/fopid_ros' >build/project.txt
  # Not `uv pip sync`: ROS 2 wheels carry metadata of packages no lock names, and sync removes their files.
  "$venv/bin/uv" pip install --quiet --python "$venv/bin/python" --no-deps --no-build-isolation \
    --reinstall -r build/project.txt
  # An editable installation leaves data files out: index markers, launch files, configuration.
  local package file
  for package in fopid_core fopid_ros; do
    rm -rf "$venv/share/$package" "$venv/lib/$package"
    (cd "src/$package" && "$venv/bin/python" -W ignore setup.py --quiet install_data --install-dir "$venv")
  done
  for file in "${shared_files[@]}"; do
    ln -sf "$root/$file" "$venv/share/fopid_ros/${file#src/fopid_ros/}"
  done
}

exec 9>"build/$name.lock"
flock 9

if [ -f "$stamp" ] && [ -x "$venv/bin/python" ] && [ "$(venv_inputs "$venv/bin/python" | checksum)" = "$(cat "$stamp")" ]; then
  exit 0
fi
if [ -f "$stamp" ] && grep -qF -- "-m venv $venv" "$venv/pyvenv.cfg" && "$venv/bin/python" -c '' 2>/dev/null; then
  # A virtual environment does not survive being moved or copied, nor the loss of its interpreter.
  say "bringing $name up to date"
  rm "$stamp"
else
  python=$(choose_python)
  say "making $name with $("$python" --version)"
  rm -rf "$venv"
  "$python" -m venv "$venv"
fi
venv_inputs "$venv/bin/python" | checksum >"$stamp.new"
install_locked
exec 8>build/.sources.lock  # both environments build in the same folders
flock 8
build_msgs
install_project
mv "$stamp.new" "$stamp"
say "ready after $SECONDS s"
