#include "tests/bench/cluster_page.h"

#include <fmt/format.h>

#include <map>
#include <utility>
#include <vector>

#include "master/html_page.h"
#include "master/svg_chart.h"

namespace preheat {
namespace {

using nlohmann::ordered_json;

std::string cell_text(const ordered_json& value) {
  if (value.is_null()) { return "\u2013"; }
  if (value.is_string()) { return value.get<std::string>(); }
  if (value.is_number_float()) { return fmt::format("{:.4g}", value.get<double>()); }
  return value.dump();
}

// Every column of the first row but hashes.
std::string rows_table(const std::string& caption, const ordered_json& rows) {
  if (rows.empty()) { return ""; }
  TableRow heading;
  for (const auto& [name, value] : rows[0].items()) {
    if (name != "image") { heading.push_back(name); }
  }
  std::vector<TableRow> lines;
  for (const ordered_json& row : rows) {
    TableRow line;
    for (const std::string& name : heading) {
      line.push_back(cell_text(row.value(name, ordered_json())));
    }
    lines.push_back(std::move(line));
  }
  return table_html(caption, heading, lines);
}

struct Curve {
  std::string title{};
  std::string x{};  // the rows' keys
  std::string y{};
  std::string x_label{};
  std::string y_label{};
  std::string series{};  // one line for each value of this key
  bool is_y_logarithmic = true;
  bool is_x_logarithmic = true;
};

// A chart for each view and number of samples, or for each view where the samples are on an axis.
std::string curves(const ordered_json& rows, const Curve& curve) {
  std::map<std::string, std::map<std::string, std::vector<ChartPoint>>> charts;
  for (const ordered_json& row : rows) {
    if (row[curve.y].is_null()) { continue; }
    std::string title = row["view"].get<std::string>();
    if (curve.x == "cache_percent") { title += fmt::format(", {} samples", row["spp"].dump()); }
    charts[title][curve.series.empty() ? std::string() : row[curve.series].get<std::string>()]
        .push_back({row[curve.x].get<double>(), row[curve.y].get<double>()});
  }
  std::string html = "<div class=\"pair\">\n";
  for (auto& [title, lines] : charts) {
    Chart chart;
    chart.title = curve.title + ": " + title;
    chart.description = "The numbers are in the table below.";
    chart.x = {curve.x_label, curve.is_x_logarithmic};
    chart.y = {curve.y_label, curve.is_y_logarithmic};
    for (auto& [name, points] : lines) {
      chart.series.push_back({name, static_cast<unsigned>(chart.series.size()) % kChartLooks,
                              ChartSeries::Style::kLine, std::move(points)});
    }
    html += figure_html(chart, chart.title);
  }
  return html + "</div>\n";
}

}  // namespace

std::string make_bench_page(const ordered_json& measured) {
  std::string html = page_begin("preheat: benchmark");
  html += "<h1>What the caches cost and save</h1>\n";
  html += fmt::format(
      "<p>preheat {}, {} on {} cores, images of {}. Times are those of one machine "
      "that runs master and workers alike; ratios are of neighbours in time.</p>\n",
      escape_markup(measured["version"].get<std::string>()),
      escape_markup(measured["machine"]["processor"].get<std::string>()),
      measured["machine"]["cores"].dump(), escape_markup(measured["size"].get<std::string>()));
  const ordered_json& sections = measured["sections"];
  const auto section = [&](const char* letter, const std::string& heading,
                           const std::vector<Curve>& shown) {
    if (!sections.contains(letter) || sections[letter].empty()) { return; }
    html += fmt::format("<h2>{}</h2>\n", escape_markup(heading));
    for (const Curve& curve : shown) { html += curves(sections[letter], curve); }
    html += rows_table(heading, sections[letter]);
  };
  section("a", "Rays per second of the tracer beside a BVH of Embree's own", {});
  section("b", "Two workers against one process with two threads", {});
  section("c", "Cache size",
          {{"Time", "cache_percent", "slowdown", "cache, % of the scene", "time / time of --local",
            "preload"},
           {"Blocks fetched", "cache_percent", "remote_bytes", "cache, % of the scene", "bytes",
            "preload"},
           {"Hit rate", "cache_percent", "hit_rate", "cache, % of the scene", "hits / accesses",
            "preload", false}});
  section("d", "Bytes over the network",
          {{"Bytes a path", "spp", "bytes_per_path", "samples per pixel", "bytes a path", ""}});
  section("e", "Hit rate over time",
          {{"Hit rate in each interval", "seconds", "hit_rate", "seconds, preload included",
            "hits / accesses", "preload", false, false}});
  section("f", "Links held to a rate", {});
  section("h", "Error against time",
          {{"Error", "seconds", "rmse", "seconds", "root mean square error", "way"}});
  section("i", "Scenes of many triangles", {});
  return html + page_end();
}

}  // namespace preheat
