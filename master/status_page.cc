#include "master/status_page.h"

#include "master/html_page.h"

namespace preheat {

const std::string_view kStatusPageHtml = R"html(<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>preheat</title>
<link rel="icon" type="image/svg+xml" href="/icon.svg">
<link rel="stylesheet" href="/status.css">
<script src="/status.js" defer></script>
</head>
<body>
<main>
<h1 id="scene">preheat</h1>
<p id="state">Asking&hellip;</p>
<p id="spoken" role="status"></p>
<progress id="progress" max="1" value="0" aria-label="Tiles that have arrived"></progress>
<noscript><p>Without scripts this page stands still: see <a href="/status.json">status.json</a>,
<a href="/image.jpg">image.jpg</a> and <a href="/metrics">metrics</a>.</p></noscript>
<div class="pair live">
<figure>
<img id="image" src="/image.jpg" alt="The image as far as it is rendered">
<figcaption id="size"></figcaption>
</figure>
<div>
<dl class="facts" id="facts"></dl>
<figure>
<svg class="chart" id="speed" role="img" aria-label="Rays per second over the last minutes"
 viewBox="0 0 400 120" width="400"><path class="axis" d="M1 0V119H400"/><path class="line look0"
 d=""/></svg>
<figcaption>Million rays a second over the last five minutes. <span id="speed-most"></span></figcaption>
</figure>
</div>
</div>
<h2>Workers</h2>
<div class="scroll" tabindex="0" role="region" aria-label="Workers">
<table>
<caption id="caption">What each worker has told last</caption>
<thead><tr><th scope="col">worker</th><th scope="col">state</th><th scope="col">threads</th>
<th scope="col">tiles held</th><th scope="col">tiles done</th><th scope="col">M rays</th>
<th scope="col">hit rate</th><th scope="col">fetches</th><th scope="col">fetched</th>
<th scope="col">waited</th><th scope="col">cache peak</th><th scope="col">of limit</th></tr></thead>
<tbody id="workers"></tbody>
</table>
</div>
<p>For programs: <a href="/status.json">status.json</a>, <a href="/metrics">metrics</a> in
Prometheus's text format, <a href="/healthz">healthz</a>.</p>
</main>
</body>
</html>
)html";

// A cell of an octree, its hottest child lit.
const std::string_view kStatusPageIcon =
    "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 16 16\"><path fill=\"#5b2a86\" "
    "d=\"M0 0h16v16H0z\"/><path fill=\"#ffb020\" d=\"M8 0h8v8H8z\"/></svg>\n";

const std::string_view kStatusPageScript = R"js("use strict";
const at = id => document.getElementById(id);
const mib = bytes => (bytes / 1048576).toFixed(1) + " MiB";
const percent = share => share === null ? "\u2013" : (100 * share).toFixed(2) + " %";
const rows_shown = 64;
const speeds_kept = 300;
const speeds = [];
let last = null;
let shown_revision = -1;
let shown_at = 0;

function clock(seconds) {
  const whole = Math.max(0, Math.round(seconds));
  const minutes = Math.floor(whole / 60) % 60;
  const two = number => String(number).padStart(2, "0");
  return (whole >= 3600 ? Math.floor(whole / 3600) + ":" + two(minutes) : minutes) + ":" +
    two(whole % 60);
}

function set_text(element, text) {
  if (element.textContent !== text) { element.textContent = text; }
}

/* Read out when it changes, so not every second. */
function speak(text) { set_text(at("spoken"), text); }

function set_facts(facts) {
  const list = at("facts");
  while (list.children.length < 2 * facts.length) {
    list.append(document.createElement("dt"), document.createElement("dd"));
  }
  facts.forEach(([name, value], i) => {
    set_text(list.children[2 * i], name);
    set_text(list.children[2 * i + 1], value);
  });
}

function show_speed(status) {
  if (last && status.time.rendering > last.seconds) {
    speeds.push((status.rays - last.rays) / (status.time.rendering - last.seconds) * 1e-6);
    if (speeds.length > speeds_kept) { speeds.shift(); }
  }
  last = {rays: status.rays, seconds: status.time.rendering};
  const most = Math.max(1e-9, ...speeds);
  const points = speeds.map((speed, i) =>
    (2 + 396 * i / (speeds_kept - 1)).toFixed(1) + " " + (118 - 112 * Math.max(0, speed) / most).toFixed(1));
  at("speed").querySelector(".line").setAttribute("d", points.length ? "M" + points.join("L") : "");
  set_text(at("speed-most"), speeds.length ? "Most: " + most.toFixed(2) + "." : "");
}

function show_workers(status) {
  const body = at("workers");
  const listed = status.worker.filter(worker => worker.state !== "gone")
    .concat(status.worker.filter(worker => worker.state === "gone")).slice(0, rows_shown);
  const columns = 12;
  while (body.rows.length < listed.length) {
    const row = body.insertRow();
    const head = document.createElement("th");
    head.scope = "row";
    row.append(head);
    for (let i = 1; i < columns; ++i) { row.insertCell(); }
  }
  while (body.rows.length > listed.length) { body.deleteRow(-1); }
  listed.forEach((worker, i) => {
    const cache = worker.cache;
    const held = cache.limit_bytes > 0 ? cache.peak_bytes / cache.limit_bytes : null;
    [String(worker.id), worker.state, String(worker.threads), String(worker.leases),
     String(worker.tiles), (worker.rays * 1e-6).toFixed(2), percent(cache.hit_rate),
     String(cache.remote_fetches), mib(cache.remote_bytes), cache.stall_seconds.toFixed(1) + " s",
     mib(cache.peak_bytes), percent(held)]
      .forEach((text, column) => set_text(body.rows[i].cells[column], text));
  });
  const hidden = status.worker.length + status.workers_not_listed - listed.length;
  set_text(at("caption"), "What each worker has told last" +
    (hidden > 0 ? "; " + hidden + " more are not listed" : ""));
}

/* The picture has its place before it has arrived. */
function show_image(status) {
  const scale = Math.min(1, 768 / Math.max(status.image.width, status.image.height));
  at("image").width = Math.max(1, Math.floor(scale * status.image.width));
  at("image").height = Math.max(1, Math.floor(scale * status.image.height));
  const now = performance.now();
  if (status.image.revision === shown_revision || now - shown_at < 1900) { return; }
  shown_revision = status.image.revision;
  shown_at = now;
  at("image").src = "/image.jpg?" + shown_revision;
}

function show(status) {
  const tiles = status.tiles;
  const share = tiles.total ? tiles.done / tiles.total : 0;
  set_text(at("scene"), status.scene);
  document.title = Math.floor(100 * share) + " % of " + status.scene;
  const left = share > 0 && share < 1
    ? ", about " + clock(status.time.rendering * (1 - share) / share) + " left" : "";
  const has_begun = status.time.rendering > 0 || tiles.done > 0;
  const before = status.workers.preparing > 0 ? "Workers load their voxels" : "Waiting for workers";
  set_text(at("state"), !has_begun
    ? before + ", " + clock(status.time.waiting) + " so far."
    : tiles.done + " of " + tiles.total + " tiles" + left + ".");
  speak(has_begun ? 10 * Math.floor(10 * share) + " % of the tiles are done." : before + ".");
  at("progress").value = share;
  set_text(at("size"), status.image.width + "\u00d7" + status.image.height + " pixels, " +
    status.image.spp + " samples, " + status.image.bounces + " bounces");
  set_facts([
    ["rendering", clock(status.time.rendering)],
    ["workers", status.workers.ready + " ready, " + status.workers.preparing + " preparing, " +
      status.workers.gone + " gone, " + status.workers.lost + " lost"],
    ["rays", (status.rays * 1e-6).toFixed(1) + " M"],
    ["hit rate", percent(status.cache.hit_rate)],
    ["fetched", status.cache.remote_fetches + " voxels, " + mib(status.cache.remote_bytes)],
    ["evictions", String(status.cache.evictions)],
    ["waited", status.cache.stall_seconds.toFixed(1) + " s of threads"],
    ["tiles given", status.leases.granted + ", " + status.leases.expired + " taken back"],
    ["version", status.version]]);
  show_speed(status);
  show_workers(status);
  show_image(status);
}

async function poll() {
  if (!document.hidden) {
    try {
      const answer = await fetch("/status.json", {signal: AbortSignal.timeout(5000)});
      show(await answer.json());
    } catch (error) {
      const told = "No answer: the render has ended, or its master is gone. " +
        "What stands here is the last that was heard.";
      set_text(at("state"), told);
      speak(told);
    }
  }
  setTimeout(poll, 1000);
}
poll();
)js";

std::string status_page_style() {
  return std::string(kPageStyle) + std::string(kChartStyle) + R"css(
progress { width: 100%; height: 1.2rem; accent-color: var(--look0); }
#spoken { position: absolute; width: 1px; height: 1px; overflow: hidden; clip-path: inset(50%); }
.live > div { flex: 1 1 22rem; }
#image { display: block; max-width: 100%; height: auto; background: var(--soft); }
.facts { display: grid; grid-template-columns: max-content auto; gap: 0.1rem 1rem; margin: 0.5rem 0; }
.facts dt { font-weight: 600; } .facts dd { margin: 0; }
a { color: var(--look0); }
)css";
}

}  // namespace preheat
