#!/usr/bin/env bash
# Builds every fuzz target and runs each for some seconds from its seeds: fuzz/run.sh [SECONDS [TARGET..]]
# Fails when an input brings a reader down, takes it longer than 20 s or more than 1 GB (requests and kept pools: 2 GiB);
# the input is then in fuzz/artifacts. Needs cargo and a C++ compiler. The flags are those of `cargo fuzz --sanitizer none`, which
# a stable compiler has too; `cargo fuzz run TARGET` searches longer where cargo-fuzz is installed.
set -euo pipefail
cd "$(dirname "$0")"
seconds=${1:-30}
shift || true
targets=("$@")
if [ ${#targets[@]} -eq 0 ]; then
    for file in fuzz_targets/*.rs; do targets+=("$(basename "$file" .rs)"); done
fi

instruments="-Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 \
-Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table \
-Cllvm-args=-sanitizer-coverage-trace-compares --cfg fuzzing"
host=$(rustc -vV | sed -n 's/^host: //p')
bins=()
for target in "${targets[@]}"; do bins+=(--bin "$target"); done
# With --target, build scripts and procedural macros are spared the instruments.
RUSTFLAGS="$instruments" cargo build --release --locked --target "$host" "${bins[@]}"

# The words of the published interface help to write requests.
mkdir -p target
grep -oE '"[a-z][a-z0-9_]*"' ../openapi/openapi.json | sort -u | sed 's/"/\\"/g; s/^/"/; s/$/"/' > target/words.dict

# Every kind has an example that runs.
mkdir -p target/examples
for example in ../src/analysis/*/example.json; do
    cp "$example" "target/examples/$(basename "$(dirname "$example")").json"
done

failed=()
for target in "${targets[@]}"; do
    printf '\n=== %s\n' "$target"
    mkdir -p "corpus/$target" "artifacts/$target"
    # The fuzzer itself keeps its corpus in the same memory.
    megabytes=954
    case $target in request | cache) megabytes=2048 ;; esac
    options=(-max_total_time="$seconds" -timeout=20 -rss_limit_mb="$megabytes" -max_len=16384 -print_final_stats=1
        -artifact_prefix="artifacts/$target/")
    seeds="seeds/$target"
    if [ "$target" = request ]; then
        options+=(-dict=target/words.dict)
        seeds=target/examples
    fi
    "target/$host/release/$target" "${options[@]}" "corpus/$target" "$seeds" || failed+=("$target")
done
if [ ${#failed[@]} -gt 0 ]; then
    printf '\nfailed: %s\n' "${failed[*]}"
    exit 1
fi
printf '\n%s targets held for %s s each\n' "${#targets[@]}" "$seconds"
