#!/usr/bin/env bash
# Makes the WebAssembly modules in crates/js from the sources, or says whether they are of these sources:
#   crates/web/build.sh             builds all modules
#   crates/web/build.sh --check     fails where a module's sources have changed since
# Needs `rustup target add wasm32-unknown-unknown`. The same compiler makes the same bytes on every machine.
set -euo pipefail
cd "$(dirname "$0")/../.."
dist=crates/js
modules=(decoder surface sender)

# What of ours a module is made of.
sources_of() {
    local hand=crates/hand codec="crates/limits crates/fba crates/codec" web=crates/web
    case $1 in
        decoder) echo $codec $hand $web ;;
        surface) echo $hand $web ;;
        sender)
            echo $codec $hand crates/live/src/{sender,transport,wire}.rs crates/media/src/lib.rs
            echo crates/{picture,vision,track} $web
            ;;
    esac
}

# Source lines of a module without comments and unit tests, which change nothing in it, as one sum.
sum_of() {
    for place in $(sources_of "$1"); do
        find "$place" -path '*/src/*' -name '*.rs' | LC_ALL=C sort | while read -r file; do
            echo "$file"
            awk '/^mod tests \{$/ { exit } !/^[ \t]*\/\// && NF' "$file"
        done
        if [ -f "$place/Cargo.toml" ]; then
            awk '/^\[dev-dependencies\]$/ { skip = 1; next } /^\[/ { skip = 0 } !skip && !/^#/ && NF' "$place/Cargo.toml"
        fi
    done | sha256sum | cut -d' ' -f1
}

if [ "${1:-}" = --check ]; then
    for module in "${modules[@]}"; do
        grep -qx "$module $(sum_of "$module")" "$dist/sources.txt" || {
            echo "$dist/handcast_$module.wasm is not made of these sources: run crates/web/build.sh" >&2
            exit 1
        }
    done
    exit 0
fi

# No path of this machine goes into a module.
flags="--remap-path-prefix=$PWD=handcast --remap-path-prefix=$(rustc --print sysroot)=rust"
for folder in "${CARGO_HOME:-$HOME/.cargo}"/registry/src/*; do
    flags+=" --remap-path-prefix=$folder=crates"
done
target=${CARGO_TARGET_DIR:-target}
: > "$dist/sources.txt"
for module in "${modules[@]}"; do
    feature=$module profile=web more=
    case $module in
        surface) profile=web-skin ;;
        sender) feature=track profile=web-fast more=" -Ctarget-feature=+simd128" ;;
    esac
    RUSTFLAGS="$flags$more" cargo rustc --quiet --locked -p handcast-web --lib --crate-type cdylib --profile "$profile" \
        --target wasm32-unknown-unknown --no-default-features --features "$feature"
    install -m 644 "$target/wasm32-unknown-unknown/$profile/handcast_web.wasm" "$dist/handcast_$module.wasm"
    echo "$module $(sum_of "$module")" >> "$dist/sources.txt"
    echo "$dist/handcast_$module.wasm: $(wc -c < "$dist/handcast_$module.wasm") bytes, gzipped $(gzip -9c "$dist/handcast_$module.wasm" | wc -c)"
done
echo "$dist/handcast.js: $(wc -c < "$dist/handcast.js") bytes, gzipped $(gzip -9c "$dist/handcast.js" | wc -c)"
