# Sourced by demo and test: makes .venv in the checkout and installs slam_bof into it.
# Usage: source _setup.sh [EXTRA]

root=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd)
venv=$root/.venv

say() { printf '%s\n' "$*" >&2; }

find_python() {
    local candidate
    for candidate in ${PYTHON:-python3.11 python3.12 python3.13 python3 python}; do
        if "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
            printf '%s\n' "$candidate"
            return
        fi
    done
    local found
    found=$("${PYTHON:-python3}" --version 2>&1) || found="no python3"
    say "error: found $found, expected CPython 3.11 or newer; set PYTHON to name one"
    return 1
}

install_into_venv() {
    local extra=${1:-} target=$root stamp wanted python
    stamp=$venv/.installed${extra:+-$extra}
    [ -n "$extra" ] && target="$root[$extra]"
    wanted=$(cat "$root/pyproject.toml" "$root/scripts/constraints.txt" | cksum; printf '%s' "$root")
    if [ -x "$venv/bin/python" ] && [ "$(cat "$stamp" 2>/dev/null)" = "$wanted" ]; then
        return
    fi
    if ! "$venv/bin/python" -c '' 2>/dev/null; then
        python=$(find_python)
        say "Making .venv with $("$python" --version)"
        if ! "$python" -m venv --clear "$venv"; then
            say "error: $python cannot make $venv; expected its venv and pip modules and a writable folder"
            return 1
        fi
    fi
    say "Installing slam_bof and what it needs (a few minutes the first time)"
    # Twice quiet: errors only. Packages of other people warn of extras that are no more.
    "$venv/bin/python" -m pip install -qq --disable-pip-version-check --no-input \
        --constraint "$root/scripts/constraints.txt" --editable "$target"
    # The stamp of the other extra stays good: both are installed from the same pins.
    printf '%s' "$wanted" >"$stamp"
}

install_into_venv "$@"
