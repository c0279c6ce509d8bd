#!/usr/bin/env bash
# Builds the wheel, puts it into an environment of its own below the target folder, and tests it beside the program, which
# HANDCAST_PROGRAM names (target/debug/handcast).
set -euo pipefail
cd "$(dirname "$0")"
target="${CARGO_TARGET_DIR:-$(cd ../.. && pwd)/target}"
export HANDCAST_PROGRAM="${HANDCAST_PROGRAM:-$target/debug/handcast}" HANDCAST_NET=none
[ -x "$HANDCAST_PROGRAM" ] || { echo "$HANDCAST_PROGRAM is not there: cargo build" >&2; exit 1; }
python="$target/python/bin/python"
"$python" -c "import maturin, numpy, distributed, mypy, matplotlib" 2>/dev/null || {
    python3 -m venv --clear "$target/python"
    "$python" -m pip install --quiet --disable-pip-version-check "maturin>=1.9.4,<2" numpy "dask[distributed]" mypy matplotlib
}
rm -rf "$target/wheels"
"$python" -m maturin build --quiet --locked --release --target-dir "$target" --out "$target/wheels" --interpreter "$python"
"$python" -m pip install --quiet --disable-pip-version-check --no-deps --force-reinstall "$target"/wheels/*.whl
# The stubs tell what there is, and the package and its example keep to them.
"$python" -m mypy.stubtest handcast --ignore-disjoint-bases
# Dask tells no types.
"$python" -m mypy --strict --allow-untyped-calls --module handcast.corpus
"$python" -m unittest discover --start-directory tests --pattern "test_*.py" "$@"
