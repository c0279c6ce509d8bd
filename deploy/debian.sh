#!/usr/bin/env bash
# The Debian package, with completions and manual, by cargo-deb (cargo install cargo-deb); its arguments are passed on.
set -euo pipefail
cd "$(dirname "$0")/.."

folder=${CARGO_TARGET_DIR:-target}
triple=
previous=
for word in "$@"; do
    [ "$previous" = --target ] && triple=$word
    case $word in --target=*) triple=${word#--target=} ;; esac
    previous=$word
done
case " $* " in
*" --no-build "*) ;;
*) CARGO_PROFILE_RELEASE_LTO=thin cargo build --locked --release -p handcast ${triple:+--target "$triple"} ;;
esac
folder+=${triple:+/$triple}
program=$folder/release/handcast
made=target/deb
mkdir -p "$made"
"$program" man -o "$made/man"
for shell in bash zsh fish; do
    "$program" completions "$shell" >"$made/handcast.$shell"
done
case " $* " in
*" --no-build "*) cargo deb --locked "$@" ;;
*) cargo deb --locked --no-build "$@" ;;
esac
