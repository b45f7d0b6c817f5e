#!/usr/bin/env bash
# Draws the table of the README's chapter on cache sizes as an SVG picture, so that the two cannot say
# different things:
#
#   tests/bench/cache_size_picture.sh > cache-size.svg
#
# `--check FILE` only says whether FILE is that picture.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."

# A row of the table is | scene | cache | time, time | hit rate, hit rate | ... |, the first of each
# pair without preloading; a scene is named in its first row only.
draw() {
  awk -F ' *[|] *' '
  function text(x, y, anchor, class, words) {
    printf "<text x=\"%.1f\" y=\"%.1f\" text-anchor=\"%s\" class=\"%s\">%s</text>\n", x, y, anchor, class, words
  }
  function across(percent) { return left + width * (log(percent) - log(3)) / (log(60) - log(3)) }
  function down(value) { return bottom - height * (value - low) / (high - low) }
  # One panel of axes; `of` is 1 for hit rates, 2 for times.
  function panel(of, title, from, to, step, format,   value, i, k, x, way, path) {
    low = from; high = to; left = of == 1 ? 60 : 470
    text(left, 30, "start", "title", title)
    for (value = low; value < high + step / 2; value += step) {
      printf "<path class=\"grid\" d=\"M%.1f %.1fh%.1f\"/>\n", left, down(value), width
      text(left - 8, down(value) + 4, "end", "tick", sprintf(format, value))
    }
    for (i = 1; i <= sizes; ++i) text(across(size[i]), bottom + 18, "middle", "tick", size[i] " %")
    text(left + width / 2, bottom + 38, "middle", "tick", "cache of each worker, % of the scene")
    for (k = 1; k <= scenes; ++k) {
      for (way = 1; way <= 2; ++way) {
        path = ""
        for (i = 1; i <= sizes; ++i) {
          x = across(size[i]); value = down(data[k, size[i], of, way])
          path = path (i > 1 ? "L" : "M") sprintf("%.1f %.1f", x, value)
          printf "<circle class=\"c%d\" cx=\"%.1f\" cy=\"%.1f\" r=\"3.5\"/>\n", k, x, value
        }
        printf "<path class=\"line l%d w%d\" d=\"%s\"/>\n", k, way, path
      }
    }
  }
  /^## / { reading = /^## Cache size/ }
  reading && $3 ~ /^[0-9.]+ %$/ {
    if ($2 != "") { scene[++scenes] = $2; sub(/,.*/, "", scene[scenes]) }
    percent = $3; sub(/ %/, "", percent)
    if (scenes == 1) size[++sizes] = percent
    split($4, times, ", *"); split($5, rates, ", *")
    for (way = 1; way <= 2; ++way) {
      data[scenes, percent, 1, way] = rates[way] + 0; data[scenes, percent, 2, way] = times[way] + 0
    }
  }
  END {
    if (scenes != 2 || sizes < 2) { print "no table of two scenes in the README" > "/dev/stderr"; exit 1 }
    width = 330; height = 230; bottom = 280
    print "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 820 390\" role=\"img\" aria-labelledby=\"t d\">"
    print "<title id=\"t\">Hit rate and time against the size of the cache</title>"
    print "<desc id=\"d\">The numbers are in the table of the README.</desc>"
    print "<style>"
    print "svg{background:#fff;font:13px system-ui,sans-serif}text{fill:#1b1f24}.title{font-weight:600;font-size:15px}"
    print ".grid{stroke:#d9dde3}.line{fill:none;stroke-width:2.5}.w1{stroke-dasharray:6 5}"
    print ".l1{stroke:#0b62a4}.c1{fill:#0b62a4}.l2{stroke:#b5520b}.c2{fill:#b5520b}"
    print "@media(prefers-color-scheme:dark){svg{background:#14171c}text{fill:#e6e9ee}.grid{stroke:#3a414c}"
    print ".l1{stroke:#6fb4ec}.c1{fill:#6fb4ec}.l2{stroke:#f0a15e}.c2{fill:#f0a15e}}"
    print "</style>"
    panel(1, "Hit rate", 0.5, 1, 0.1, "%.1f")
    panel(2, "Time / time of --local", 0, 5, 1, "%d")
    for (k = 1; k <= scenes; ++k) {
      for (way = 1; way <= 2; ++way) {
        x = 60 + 410 * (k - 1); y = 330 + 22 * way
        printf "<path class=\"line l%d w%d\" d=\"M%d %dh32\"/>\n", k, way, x, y
        text(x + 40, y + 4, "start", "tick", scene[k] (way == 1 ? ", not preloaded" : ", preloaded"))
      }
    }
    print "</svg>"
  }' README.md
}

if [[ ${1:-} == --check ]]; then
  draw | cmp - "${2:?which file}"
else
  draw
fi
