#include "master/render_page.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <numeric>
#include <optional>
#include <utility>
#include <vector>

#include "master/heat_colors.h"
#include "master/html_page.h"
#include "master/png_image.h"
#include "master/srgb.h"
#include "master/voxel_view.h"
#include "master/worker_charts.h"

namespace preheat {
namespace {

constexpr std::uint32_t kImageSideShown = 1280;
constexpr std::uint32_t kHeatSideShown = 640;
constexpr std::size_t kHottestShown = 20;
constexpr std::size_t kSeriesShown = 8;    // lines in a chart; of more workers only the sum
constexpr std::size_t kIntervalsMax = 60;  // of time, in charts
constexpr double kDecadesShown = 4.0;      // below the hottest voxel; colder ones look alike
constexpr double kStopsShown = 3.0;        // of the difference: a factor of 8 either way

constexpr std::string_view kRenderStyle = R"css(
img { display: block; max-width: 100%; height: auto; background: repeating-conic-gradient(
  var(--soft) 0% 25%, var(--grid) 0% 50%) 0 0 / 16px 16px; }
.heat figure { flex: 1 1 20rem; }
.legend { display: block; max-width: 26rem; margin-top: 0.4rem; }
.facts { display: grid; grid-template-columns: max-content auto; gap: 0.1rem 1rem; margin: 0.5rem 0; }
.facts dt { font-weight: 600; } .facts dd { margin: 0; overflow-wrap: anywhere; }
summary { cursor: pointer; padding: 0.3rem 0; }
)css";

std::string in_mib(double bytes) { return fmt::format("{:.1f} MiB", bytes / 1048576.0); }
std::string in_mib(std::uint64_t bytes) { return in_mib(static_cast<double>(bytes)); }

std::string picture_html(const std::string& bytes, const char* type, std::uint32_t width,
                         std::uint32_t height, const std::string& what) {
  if (bytes.empty()) { return "<p>The picture could not be encoded.</p>\n"; }
  return fmt::format(
      "<img alt=\"{}\" width=\"{}\" height=\"{}\" src=\"data:image/{};base64,{}\">\n",
      escape_markup(what), width, height, type, base64(bytes));
}

// Means of linear radiance where several pixels of the film fall into one of the picture.
std::string film_html(const Film& film, double exposure_ev) {
  const double scale =
      std::min(1.0, static_cast<double>(kImageSideShown) / std::max(film.width(), film.height()));
  const auto width = std::max(1U, static_cast<std::uint32_t>(scale * film.width()));
  const auto height = std::max(1U, static_cast<std::uint32_t>(scale * film.height()));
  const double gain = std::exp2(exposure_ev);
  std::vector<std::uint8_t> codes;
  codes.reserve(std::size_t{3} * width * height);
  const auto bound = [](std::uint64_t index, std::uint32_t from, std::uint32_t to) {
    return static_cast<std::uint32_t>(index * from / to);
  };
  for (std::uint32_t row = 0; row < height; ++row) {
    const std::uint32_t top = bound(row, film.height(), height);
    const std::uint32_t bottom = bound(row + 1, film.height(), height);
    for (std::uint32_t column = 0; column < width; ++column) {
      const std::uint32_t left = bound(column, film.width(), width);
      const std::uint32_t right = bound(column + 1, film.width(), width);
      std::array<double, 3> sum{};
      for (std::uint32_t y = top; y < bottom; ++y) {
        for (std::uint32_t x = left; x < right; ++x) {
          for (std::size_t channel = 0; channel < 3; ++channel) {
            sum[channel] +=
                static_cast<double>(film.rgb()[(std::size_t{y} * film.width() + x) * 3 + channel]);
          }
        }
      }
      const double pixels = static_cast<double>(bottom - top) * (right - left);
      for (const double value : sum) { codes.push_back(srgb_from_linear(gain * value / pixels)); }
    }
  }
  return picture_html(encode_png(codes, width, height, 3), "png", width, height,
                      "The rendered image");
}

// A bar of colours with labels below, as read out by `meaning`.
struct Legend {
  std::string meaning{};
  std::function<Rgb8(double)> color{};                   // of a place in [0,1]
  std::vector<std::pair<double, std::string>> labels{};  // places in [0,1]
};

std::string legend_svg(const Legend& legend) {
  constexpr int kSteps = 48;
  constexpr double kLeft = 30.0;
  constexpr double kLength = 336.0;
  std::string svg = fmt::format(
      "<svg class=\"chart legend\" role=\"img\" aria-label=\"{}\" viewBox=\"0 0 400 40\" "
      "width=\"400\">\n",
      escape_markup(legend.meaning));
  for (int step = 0; step < kSteps; ++step) {
    svg += fmt::format("<rect x=\"{:.1f}\" y=\"2\" width=\"{:.1f}\" height=\"14\" fill=\"{}\"/>",
                       kLeft + kLength * step / kSteps, kLength / kSteps + 0.4,
                       css_color(legend.color((step + 0.5) / kSteps)));
  }
  for (const auto& [place, text] : legend.labels) {
    svg += fmt::format(
        "\n<path class=\"axis\" d=\"M{0:.1f} 16v5\"/><text class=\"tick\" x=\"{0:.1f}\" y=\"34\" "
        "text-anchor=\"middle\">{1}</text>",
        kLeft + kLength * place, escape_markup(text));
  }
  return svg + "\n</svg>\n";
}

// Rays per voxel on a logarithmic scale of which both pictures make use.
class HeatScale {
 public:
  explicit HeatScale(double most)
      : high_(std::max(1.0, most)), low_(high_ / std::pow(10.0, kDecadesShown)) {}

  [[nodiscard]] double place(double rays) const {
    return std::log10(std::max(rays, low_) / low_) / kDecadesShown;
  }
  // Positive where more was predicted than counted, 1 and -1 at a factor of 2^kStopsShown.
  [[nodiscard]] double difference(double predicted, double counted) const {
    return std::log2(std::max(predicted, low_) / std::max(counted, low_)) / kStopsShown;
  }
  [[nodiscard]] Legend legend() const {
    Legend legend{"Colours from few to many rays per voxel", heat_color, {}};
    for (const double tick : axis_ticks(low_, high_, true)) {
      legend.labels.emplace_back(place(tick), tick_text(tick));
    }
    return legend;
  }

 private:
  double high_;
  double low_;
};

Legend difference_legend() {
  Legend legend{"Colours from too few rays predicted to too many",
                [](double place) { return difference_color(2.0 * place - 1.0); },
                {}};
  for (int stop = -3; stop <= 3; ++stop) {
    legend.labels.emplace_back(
        (stop + kStopsShown) / (2.0 * kStopsShown),
        stop < 0 ? fmt::format("1/{}", 1 << -stop) : fmt::format("{}x", 1 << stop));
  }
  return legend;
}

class Page {
 public:
  Page(const RenderRecord& record, const nlohmann::ordered_json& report, double exposure_ev)
      : record_(record),
        report_(report),
        exposure_ev_(exposure_ev),
        history_(record.result->history),
        counted_(record.result->accesses_by_voxel) {
    if (record.prediction->model != "none") {
      for (std::size_t voxel = 0; voxel < voxels().size(); ++voxel) {
        predicted_.push_back(record.prediction->rays(voxel));
      }
    }
  }

  [[nodiscard]] std::string html() const {
    return page_begin("Render of " + record_.store->info().source_file,
                      std::string(kRenderStyle) + std::string(kWorkerChartStyle)) +
           introduction() + heat() + over_time() + workers() + hottest() + settings() + page_end();
  }

 private:
  [[nodiscard]] const std::vector<VoxelEntry>& voxels() const {
    return record_.store->tables().voxels;
  }

  [[nodiscard]] std::string introduction() const {
    const RenderSettings& settings = record_.view->settings;
    const PhaseSeconds& time = record_.seconds;
    const auto& cache = report_["cache"];
    const auto& hit_rate = cache["hit_rate"];
    std::string html = fmt::format(
        "<h1>Render of {}</h1>\n<figure>\n{}<figcaption>{}\u00d7{} pixels, {} samples, {} bounces, "
        "{}.</figcaption>\n</figure>\n<dl class=\"facts\">\n",
        escape_markup(record_.store->info().source_file),
        film_html(record_.result->film, exposure_ev_), settings.width, settings.height,
        settings.spp, settings.bounces, escape_markup(record_.view->camera_source));
    const auto fact = [&html](const char* name, const std::string& value) {
      html += fmt::format("<dt>{}</dt><dd>{}</dd>\n", name, escape_markup(value));
    };
    fact("time", fmt::format("{:.2f} s: compile {:.2f}, predict {:.2f}, preload {:.2f}, render "
                             "{:.2f}",
                             time.total(), time.compile, time.predict, time.preload, time.render));
    fact("scene", fmt::format("{} triangles in {} voxels, {} when all are held",
                              record_.store->tables().triangle_count, voxels().size(),
                              in_mib(record_.store->tables().resident_bytes())));
    fact("rays", fmt::format("{:.2f} M", report_["rays"]["total"].get<double>() * 1e-6));
    fact("cache",
         fmt::format("hit rate {}, limit {}, preloaded {}",
                     hit_rate.is_null() ? std::string("not counted")
                                        : fmt::format("{:.3f} %", 100.0 * hit_rate.get<double>()),
                     in_mib(cache["limit_bytes"].get<double>()),
                     in_mib(report_["preload"]["bytes"].get<double>())));
    fact("fetched", fmt::format("{} voxels, {}", cache["remote_fetches"].get<std::uint64_t>(),
                                in_mib(cache["remote_bytes"].get<double>())));
    fact("SHA-256 of the pixels", record_.pixels_sha256);
    return html + "</dl>\n";
  }

  [[nodiscard]] std::string heat_figure(const VoxelView& view, const std::string& what,
                                        const std::string& caption, const Legend& legend,
                                        const std::function<Rgb8(std::uint32_t)>& color_of) const {
    return fmt::format(
        "<figure>\n{}{}<figcaption>{}</figcaption>\n</figure>\n",
        picture_html(paint_voxels(view, color_of), "png", view.width, view.height, what),
        legend_svg(legend), escape_markup(caption));
  }

  [[nodiscard]] std::string heat() const {
    std::string html =
        "<h2>Heat of the voxels</h2>\n<p>Every pixel has the colour of the voxel that holds the "
        "surface it sees: how many rays of the whole render entered that voxel's bounds, camera, "
        "scattered and shadow rays together. The surface is found in the summary that predictions "
        "are made from, so its edges are blunt.</p>\n";
    if (predicted_.empty()) { html += "<p>Nothing was predicted.</p>\n"; }
    if (counted_.empty()) {
      html +=
          "<p>Counts are not known: accesses were not counted, or a worker that counted some "
          "was lost before the end.</p>\n";
    }
    const auto view = see_voxels(record_.store->tables(), record_.store->proxy(),
                                 record_.view->settings, kHeatSideShown);
    if (!view) { return html + "<p>" + escape_markup(view.error().message) + "</p>\n"; }
    double most = 0.0;
    for (const std::uint32_t voxel : view->voxels) {
      if (voxel == VoxelView::kNone) { continue; }
      if (!predicted_.empty()) { most = std::max(most, predicted_[voxel]); }
      if (!counted_.empty()) { most = std::max(most, counted_[voxel]); }
    }
    const HeatScale scale(most);
    const auto picture = [&](const std::vector<double>& rays, const char* what,
                             const std::string& caption) {
      return heat_figure(*view, what, caption, scale.legend(),
                         [&](std::uint32_t voxel) { return heat_color(scale.place(rays[voxel])); });
    };
    html += "<div class=\"pair heat\">\n";
    if (!predicted_.empty()) {
      html += picture(predicted_, "False colours: rays per voxel as predicted",
                      fmt::format("Predicted by {} before the first ray, in rays per voxel.",
                                  record_.prediction->model));
    }
    if (!counted_.empty()) {
      html += picture(counted_, "False colours: rays per voxel as counted",
                      "Counted while rendering, in rays per voxel.");
    }
    if (!predicted_.empty() && !counted_.empty()) {
      html += heat_figure(
          *view, "False colours: predicted over counted rays per voxel",
          "Predicted over counted: white where they agree, orange where too many rays were "
          "predicted, blue where too few.",
          difference_legend(), [&](std::uint32_t voxel) {
            return difference_color(scale.difference(predicted_[voxel], counted_[voxel]));
          });
    }
    return html + "</div>\n";
  }

  // What is drawn and tabled as one line: a worker, or all of them.
  struct Group {
    std::string name;
    std::vector<const WorkerHistory*> members;
    template <class Number>
    [[nodiscard]] double count(Number HistoryPoint::*which, double seconds) const {
      double sum = 0.0;
      for (const WorkerHistory* worker : members) { sum += count_at(*worker, which, seconds); }
      return sum;
    }
  };

  [[nodiscard]] std::vector<Group> groups() const {
    std::vector<Group> groups;
    Group all{"all workers", {}};
    for (std::size_t id = 0; id < history_.workers.size(); ++id) {
      all.members.push_back(&history_.workers[id]);
      if (history_.workers.size() <= kSeriesShown) {
        groups.push_back({fmt::format("worker {}", id), {&history_.workers[id]}});
      }
    }
    if (groups.size() != 1) { groups.push_back(std::move(all)); }
    return groups;
  }

  // Nothing where no ray entered a voxel, or none was counted.
  [[nodiscard]] static std::optional<double> hit_rate(const Group& group, double from, double to) {
    const auto grown = [&](std::uint64_t HistoryPoint::*count) {
      return group.count(count, to) - group.count(count, from);
    };
    const double accesses = grown(&HistoryPoint::accesses);
    if (!(accesses > 0.0)) { return std::nullopt; }
    return std::clamp(1.0 - grown(&HistoryPoint::misses) / accesses, 0.0, 1.0);
  }

  // Hit rates differ in their last percents: the axis ends below the least one.
  [[nodiscard]] static double hit_axis_low(double least) {
    const double low = std::floor(20.0 * least - 0.2) / 20.0;
    return low < 0.5 ? 0.0 : low;
  }

  [[nodiscard]] std::string over_time() const {
    Chart hits;
    hits.title = "Hit rate over time";
    hits.description = "Share of a voxel's entries that found it held, in each interval of time.";
    hits.x = {"seconds since the first tile was handed out"};
    hits.y = {"hit rate in the interval", false, 0.0, 1.0};
    Chart bytes;
    bytes.title = "Bytes fetched over time";
    bytes.description = "Of voxels that arrived after the first tile began, so far.";
    bytes.x = hits.x;
    bytes.y = {"MiB fetched so far"};
    const std::vector<Group> lines = groups();
    TableRow heading{"until"};
    double least = 1.0;
    std::vector<TableRow> rows;
    for (const double end : interval_ends(history_, kIntervalsMax)) {
      rows.push_back({fmt::format("{:.2f} s", end)});
    }
    for (std::size_t line = 0; line < lines.size(); ++line) {
      const auto look = static_cast<unsigned>(line);
      ChartSeries rate{lines[line].name, look, ChartSeries::Style::kLine, {}};
      ChartSeries fetched{lines[line].name, look, ChartSeries::Style::kLine, {{0.0, 0.0}}};
      heading.push_back(lines[line].name + ": hit rate");
      heading.push_back("fetched");
      double begin = 0.0;
      std::size_t row = 0;
      for (const double end : interval_ends(history_, kIntervalsMax)) {
        const std::optional<double> share = hit_rate(lines[line], begin, end);
        const double so_far = lines[line].count(&HistoryPoint::remote_bytes, end);
        if (share) {
          rate.points.push_back({end, *share});
          least = std::min(least, *share);
        }
        fetched.points.push_back({end, so_far / 1048576.0});
        rows[row].push_back(share ? fmt::format("{:.2f} %", 100.0 * *share) : "\u2013");
        rows[row].push_back(in_mib(so_far));
        begin = end;
        ++row;
      }
      hits.series.push_back(std::move(rate));
      bytes.series.push_back(std::move(fetched));
    }
    if (history_.workers.empty()) { return {}; }
    hits.y.low = hit_axis_low(least);
    return "<h2>Cache over time</h2>\n<div class=\"pair\">\n" +
           figure_html(
               hits, fmt::format("The axis begins at {:.2f}. {}", hits.y.low,
                                 history_.workers.size() > kSeriesShown
                                     ? "More workers than lines can be told apart: the sum of all."
                                     : "Workers tell their counts up to five times a second.")) +
           figure_html(bytes, "Voxels that were preloaded are not in it.") +
           "</div>\n<details><summary>The numbers of both charts</summary>\n" +
           table_html("Hit rate in each interval and bytes fetched until its end", heading, rows) +
           "</details>\n";
  }

  [[nodiscard]] std::string workers() const {
    std::vector<TableRow> rows;
    for (std::size_t id = 0; id < record_.result->workers.size(); ++id) {
      const WorkerStats& stats = record_.result->workers[id];
      const CacheStats& cache = stats.cache;
      ThreadSeconds time;
      std::string here = "\u2013";
      if (id < history_.workers.size()) {
        const WorkerHistory& worker = history_.workers[id];
        time = thread_seconds(worker);
        here = fmt::format("{:.2f} to {:.2f} s{}", worker.begin_seconds, worker.end_seconds,
                           worker.lost ? ", lost" : "");
      }
      rows.push_back(
          {fmt::format("worker {}", id), here, fmt::format("{}", stats.tiles),
           fmt::format("{:.2f} M", static_cast<double>(stats.rays.total()) * 1e-6),
           cache.accesses == 0
               ? std::string("\u2013")
               : fmt::format(
                     "{:.3f} %",
                     100.0 - 100.0 * std::min(1.0, static_cast<double>(cache.misses) /
                                                       static_cast<double>(cache.accesses))),
           fmt::format("{}", cache.remote_fetches), in_mib(cache.remote_bytes),
           fmt::format("{}", cache.evictions), in_mib(cache.peak_bytes),
           fmt::format("{:.2f} s", time.total - time.waiting),
           fmt::format("{:.2f} s ({:.1f} %)", time.waiting, 100.0 * time.share_waiting())});
    }
    std::string html = "<h2>Workers</h2>\n";
    if (history_.workers.size() > kChartRowsMax) {
      html += fmt::format("<p>The charts show the first {} workers, the table all of them.</p>\n",
                          kChartRowsMax);
    }
    html +=
        "<h3>Tiles over time</h3>\n<figure>\n<div class=\"scroll\" tabindex=\"0\" "
        "role=\"region\" aria-label=\"Tiles over time\">" +
        tile_timeline_svg(history_) +
        "</div><figcaption>A bar ends when a result arrived and begins where that worker's "
        "previous one did, or when the tile was handed out. Behind the bars: when the worker "
        "was there.</figcaption>\n</figure>\n";
    html +=
        "<h3>Tracing and waiting</h3>\n<figure>\n<div class=\"scroll\" tabindex=\"0\" "
        "role=\"region\" aria-label=\"Tracing and waiting\">" +
        waiting_svg(history_) +
        "</div><figcaption>Solid: seconds in which threads traced or had no tile. Dashed: "
        "seconds without a ray that could run, because voxels were on their way."
        "</figcaption>\n</figure>\n";
    return html + table_html("What each worker did",
                             {"worker", "here", "tiles", "rays", "hit rate", "fetches", "fetched",
                              "evictions", "peak of the cache", "not waiting", "waiting"},
                             rows);
  }

  [[nodiscard]] std::string hottest() const {
    const std::vector<double>& rank = counted_.empty() ? predicted_ : counted_;
    if (rank.empty()) { return {}; }
    const double sum = std::accumulate(rank.begin(), rank.end(), 0.0);
    std::vector<std::uint32_t> order(rank.size());
    std::iota(order.begin(), order.end(), 0U);
    const std::size_t shown = std::min(kHottestShown, order.size());
    std::partial_sort(order.begin(), order.begin() + static_cast<std::ptrdiff_t>(shown),
                      order.end(), [&](std::uint32_t a, std::uint32_t b) {
                        return rank[a] != rank[b] ? rank[a] > rank[b] : a < b;
                      });
    std::vector<TableRow> rows;
    for (std::size_t i = 0; i < shown; ++i) {
      const std::uint32_t id = order[i];
      const VoxelEntry& voxel = voxels()[id];
      const auto rays = [](double value) { return fmt::format("{:.0f}", value); };
      rows.push_back(
          {fmt::format("voxel {}", id), counted_.empty() ? "\u2013" : rays(counted_[id]),
           predicted_.empty() ? "\u2013" : rays(predicted_[id]),
           counted_.empty() || predicted_.empty() || !(counted_[id] > 0.0)
               ? "\u2013"
               : fmt::format("{:.2f}", predicted_[id] / counted_[id]),
           fmt::format("{:.2f} %", sum > 0.0 ? 100.0 * rank[id] / sum : 0.0),
           fmt::format("{}", voxel.triangle_count),
           fmt::format("{:.1f} KiB", static_cast<double>(voxel.resident_bytes) / 1024.0)});
    }
    return "<h2>Hottest voxels</h2>\n" +
           table_html(fmt::format("The {} of {} voxels that most rays {}", shown, rank.size(),
                                  counted_.empty() ? "were predicted for" : "entered"),
                      {"voxel", "rays counted", "predicted", "predicted / counted",
                       "share of all entries", "triangles", "held"},
                      rows);
  }

  static void flatten(const nlohmann::ordered_json& json, const std::string& name,
                      std::vector<TableRow>& rows) {
    if (json.is_object() && !json.empty()) {
      for (const auto& [key, value] : json.items()) {
        flatten(value, name.empty() ? key : name + "." + key, rows);
      }
      return;
    }
    using Json = nlohmann::ordered_json;
    rows.push_back({name, json.is_string()
                              ? json.get<std::string>()
                              : json.dump(-1, ' ', false, Json::error_handler_t::replace)});
  }

  [[nodiscard]] std::string settings() const {
    std::vector<TableRow> rows;
    for (const auto& [key, value] : report_.items()) {
      if (key != "workers") { flatten(value, key, rows); }
    }
    return "<h2>Settings, versions and counts</h2>\n<details><summary>Everything in the report but "
           "its list of workers</summary>\n" +
           table_html("The report's values by name", {"name", "value"}, rows) + "</details>\n";
  }

  const RenderRecord& record_;
  const nlohmann::ordered_json& report_;
  double exposure_ev_;
  const RenderHistory& history_;
  const std::vector<double>& counted_;
  std::vector<double> predicted_;
};

}  // namespace

std::string make_render_page(const RenderRecord& record, const nlohmann::ordered_json& report,
                             double exposure_ev) {
  return Page(record, report, exposure_ev).html();
}

}  // namespace preheat
