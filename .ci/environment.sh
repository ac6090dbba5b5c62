# Sourced by the scripts of this folder: the root of the checkout as working folder, settings, and shell functions.
cd "$(dirname "${BASH_SOURCE[0]}")/.."
root=$PWD
python=$root/.venv/bin/python

export PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_QUIET=1
# Report the slowest tests, so that growth is seen. A worker without tests takes over tests of the others.
export PYTEST_ADDOPTS="${PYTEST_ADDOPTS:-} --durations=20 --durations-min=5 --dist worksteal"
if [ -d "$root/../shared" ]; then export WARPCONTACT_SHARED=${WARPCONTACT_SHARED:-$(cd "$root/../shared" && pwd)}; fi

# Prints the command in the code block after the marker <!-- $1 --> of the README.
command_of() { awk -v mark="<!-- $1 -->" '$0 == mark {found = 1; next} found && /^```bash/ {inside = 1; next} inside && /^```/ {exit} inside' README.md; }

# Runs a command of the README as users do.
readme() { bash -euo pipefail -c "$(command_of "$1")"; }

times=()
# Starts a section and stores the duration of the last one.
section() {
    finish_section
    section_name=$1 section_start=$SECONDS
    printf '\n=== %s (%s s)\n' "$1" "$SECONDS"
}
finish_section() {
    if [ -n "${section_name:-}" ]; then times+=("$(printf '%5d s  %s' $((SECONDS - section_start)) "$section_name")"); fi
    section_name=
}
# Prints the duration of each section.
report_times() {
    finish_section
    printf '\n=== time by section\n'
    printf '%s\n' "${times[@]}"
    printf '%5d s  in all\n' "$SECONDS"
}

# Creates the virtual environment if it is missing, and installs the checkout with the extras $1.
install_checkout() {
    [ -x "$python" ] || python3 -m venv "$root/.venv"
    "$python" -m pip install -e ".[$1]"
}

# Returns success if Chromium is there or can be installed.
have_chromium() {
    command -v chromium chromium-browser google-chrome chrome >/dev/null && return
    [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null && apt-get update -qq && apt-get install -y -qq chromium >/dev/null 2>&1
}

# Builds the wheel and installs it with the extras $1 and further packages into a new virtual environment in the folder
# $2. Fails unless the installed files are those of the checkout.
install_wheel() {
    "$python" -m pip install build
    rm -rf build warpcontact.egg-info  # setuptools also packs the files of an earlier build
    "$python" -m build --wheel --outdir "$2" . >"$2/build.log" || { cat "$2/build.log"; return 1; }
    python3 -m venv "$2/venv"
    "$2/venv/bin/pip" install "$(ls "$2"/warpcontact-*.whl)[$1]" "${@:3}"
    local installed
    installed=$(ls -d "$2"/venv/lib/python3*/site-packages/warpcontact)
    diff -r -x __pycache__ -x kernels warpcontact "$installed"
    diff -r -x __pycache__ kernels "$installed/kernels"
    cp -r tests examples pyproject.toml "$2/"
}
