#!/usr/bin/env bash
# Draws an MCAP file of `tactile` in a stock viewer without a screen: rerun.sh FILE.mcap PICTURE.png
#
# Needs `pip install rerun-sdk` (0.41) and, on Debian, `apt-get install xvfb mesa-vulkan-drivers`.
# RERUN names the program where it is not on the path. Without them it says so and succeeds.
set -euo pipefail
file=$1 picture=$2
rerun=${RERUN:-rerun}
for program in "$rerun" xvfb-run; do
  command -v "$program" >/dev/null || { echo "skipped: needs $program"; exit 0; }
done
"$rerun" mcap check "$file"
home=$(mktemp -d)
trap 'rm -rf "$home"' EXIT
XDG_RUNTIME_DIR=$home RERUN_ANALYTICS_ENABLED=0 timeout 120 \
  xvfb-run -a -s '-screen 0 1600x1000x24' \
  "$rerun" --port auto --bind 127.0.0.1 --window-size 1500x900 --renderer vulkan \
  --screenshot-to "$picture" "$file"
test -s "$picture"
