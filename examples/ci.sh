#!/bin/sh
# Check a scenario, run its twin, and compare that with a reference run: the steps of action.yml, for
# any CI server. The folder OUT is what to keep: reports, runs, and a JUnit file of the comparison.
#   SCENARIO=law.toml DEPLOY=can REFERENCE=runs/first OUT=cosim-out sh ci.sh
set -eu
cosim check "$SCENARIO" --deploy "${DEPLOY:-}"
cosim run "$SCENARIO" --deploy "${DEPLOY:-}" --out "$OUT/twin"
[ -z "${REFERENCE:-}" ] ||
    cosim diff "$REFERENCE" "$OUT/twin" --html "$OUT/difference.html" --junit "$OUT/difference.xml"
