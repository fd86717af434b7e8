#!/bin/sh
# Makes the first corpus: the fixtures of the tests, and small files that the targets make themselves by the program and its encoders.
#
#   fuzz/seed.sh [FOLDER]      fuzz/corpus by default; what is there stays
set -eu
cd "$(dirname "$0")"
corpus=${1:-$PWD/corpus}
triple=$(rustc -vV | sed -n 's/^host: //p')
target="target/$triple/release/photograph"
[ -x "$target" ] || cargo +nightly fuzz build photograph
mkdir -p "$corpus/photograph" "$corpus/plans"
scratch=$(mktemp -d)
TMPDIR=$scratch ASAN_OPTIONS=detect_leaks=0 HDRALIGN_FUZZ_SEEDS=$corpus "$target"
rm -rf "$scratch"
cp ../tests/fixtures/*.jpg ../tests/fixtures/raw/*.dng "$corpus/photograph/"
# The photographs of testdata are too long to be changed byte by byte; what stands before their pixels is not.
for photograph in ../testdata/window/*.jpg; do
    head -c 4096 "$photograph" >"$corpus/photograph/head-$(basename "$photograph")"
done
