#include "master/evaluate_page.h"

#include <fmt/format.h>

#include <algorithm>
#include <map>

#include "master/html_page.h"

namespace preheat {
namespace {

// A curve of more cells than this shows the means of neighbours.
constexpr std::size_t kCurvePointsMax = 400;

std::string digits(double value, int count) { return fmt::format("{:.{}g}", value, count); }

std::string text_of(const std::optional<double>& value, int count = 4) {
  return value ? digits(*value, count) : std::string("\u2013");
}

using Row = TableRow;

std::string capture_text(const std::optional<Captured>& captured, std::size_t share) {
  return captured ? fmt::format("{:.2f}", 100.0 * captured->shares[share]) : std::string("\u2013");
}

// One look for each model, the same in every chart.
class Looks {
 public:
  unsigned of(const std::string& model) {
    return looks_.try_emplace(model, static_cast<unsigned>(looks_.size()) % kChartLooks)
        .first->second;
  }

 private:
  std::map<std::string, unsigned> looks_;
};

class Page {
 public:
  explicit Page(const EvaluationRecord& record) : record_(record) {
    for (const ModelResult& model : record.models) { looks_.of(model.name); }
  }

  [[nodiscard]] std::string html() {
    std::string page = page_begin("Prediction against counted rays: " + record_.scene);
    page += introduction() + models();
    if (record_.oracle) { page += captures(); }
    page += speed() + fits() + curves();
    if (!record_.ablation.empty()) { page += ablation(); }
    return page + page_end();
  }

 private:
  [[nodiscard]] std::string introduction() const {
    return fmt::format(
        "<h1>Prediction against counted rays</h1>\n"
        "<p>{} ({} triangles), {}, {}\u00d7{} pixels, {} samples, {} bounces, {} thread(s). "
        "A render counted {} rays in {:.2f} s ({} camera, {} scatter, {} shadow) and, for each "
        "{}, the rays that entered it. One sample a pixel takes {:.3f} s to trace.</p>\n",
        escape_markup(record_.scene), record_.triangles, escape_markup(record_.camera),
        record_.width, record_.height, record_.spp, record_.bounces, record_.threads,
        record_.rays.total(), record_.truth_seconds, record_.rays.camera, record_.rays.scatter,
        record_.rays.shadow, escape_markup(record_.unit), record_.one_spp_seconds);
  }

  [[nodiscard]] Row model_row(const std::string& name, const Judgement& judgement) const {
    const Evaluation& fit = judgement.all;
    Row row{name,
            fmt::format("{:.4f}", judgement.seconds),
            record_.one_spp_seconds > 0.0
                ? digits(100.0 * judgement.seconds / record_.one_spp_seconds, 3) + " %"
                : std::string("\u2013"),
            text_of(fit.alpha),
            text_of(fit.beta),
            text_of(fit.sigma_over_mean),
            text_of(fit.r2),
            text_of(fit.pearson),
            text_of(fit.spearman),
            text_of(fit.total_ratio)};
    for (std::size_t share = 0; share < kCaptureShares.size(); ++share) {
      row.push_back(capture_text(judgement.captured, share));
    }
    return row;
  }

  [[nodiscard]] static Row model_heading(const std::string& first) {
    return {first,           "seconds",
            "of one sample", "alpha",
            "beta",          "sigma / mean r",
            "R\u00b2",       "Pearson",
            "Spearman",      "\u03a3e / \u03a3r",
            "capture 1 %",   "10 %",
            "25 %",          "50 % of bytes, in %"};
  }

  [[nodiscard]] std::string models() const {
    std::vector<Row> rows;
    for (const ModelResult& model : record_.models) {
      const std::string name =
          model.knobs.empty() ? model.name : fmt::format("{} ({})", model.name, model.knobs);
      rows.push_back(model_row(name, model.judgement));
    }
    std::string html = "<h2>All models</h2>\n";
    if (record_.oracle) {
      Row best(10, "\u2013");
      best[0] = "best possible (the counts themselves)";
      best[1] = fmt::format("{:.4f}", record_.truth_seconds);
      for (std::size_t share = 0; share < kCaptureShares.size(); ++share) {
        best.push_back(capture_text(record_.oracle, share));
      }
      rows.push_back(best);
    }
    html += table_html(fmt::format("Estimated (e) against counted (r) rays per {}: the line "
                                   "e = alpha + beta r, what it leaves, and the share of all "
                                   "accesses in the hottest bytes by each model's ranking",
                                   record_.unit),
                       model_heading("model"), rows);
    return html;
  }

  [[nodiscard]] std::string captures() {
    Chart chart;
    chart.title = "Captured accesses over the share of bytes held";
    chart.description =
        "One curve for each model and one for the counts themselves, which no model exceeds. The "
        "table of all models has the numbers.";
    chart.x = {"share of the scene's bytes held", true, 1e-3, 1.0};
    chart.y = {"share of accesses that find their voxel", false, 0.0, 1.0};
    chart.width = 760;
    chart.height = 440;
    const auto add = [&](const std::string& name, const Captured& captured) {
      ChartSeries& series = chart.series.emplace_back();
      series.name = name;
      series.look = looks_.of(name);
      for (const CapturePoint& point : captured.curve) {
        series.points.push_back({point.bytes_share, point.accesses_share});
      }
    };
    for (const ModelResult& model : record_.models) {
      if (model.judgement.captured) { add(model.name, *model.judgement.captured); }
    }
    add("best possible", *record_.oracle);
    return "<h2>Capture</h2>\n" +
           figure_html(chart,
                       "Voxels are taken in each model's order of rays per byte until the share "
                       "of bytes is full; the last one counts in part.");
  }

  // Of every setting that was tried: the models as they were asked for, then the sweep's.
  struct Trial {
    std::string model;
    std::string knobs;
    const Judgement* judgement;
    bool is_default;
    bool is_on_front;
    bool is_knee;
  };
  [[nodiscard]] std::vector<Trial> trials() const {
    std::vector<Trial> list;
    for (const SweepResult& setting : record_.sweep) {
      list.push_back({setting.model, setting.knobs, &setting.judgement, setting.is_default,
                      setting.is_on_front, setting.is_knee});
    }
    if (!list.empty()) { return list; }
    for (const ModelResult& model : record_.models) {
      list.push_back({model.name, model.knobs, &model.judgement, true, false, false});
    }
    return list;
  }

  [[nodiscard]] std::optional<double> lost_capture(const Judgement& judgement) const {
    if (!judgement.captured || !record_.oracle || !(record_.oracle->shares[kQuarter] > 0.0)) {
      return std::nullopt;
    }
    return std::max(0.0,
                    1.0 - judgement.captured->shares[kQuarter] / record_.oracle->shares[kQuarter]);
  }

  using Error = std::optional<double> (Page::*)(const Judgement&) const;
  [[nodiscard]] std::optional<double> sigma_error(const Judgement& judgement) const {
    return judgement.all.sigma_over_mean;
  }
  [[nodiscard]] std::optional<double> unexplained_error(const Judgement& judgement) const {
    return unexplained(judgement.all);
  }

  [[nodiscard]] Chart speed_chart(const std::string& what, Error error_of) {
    Chart chart;
    chart.title = "Seconds against " + what;
    chart.description = "One mark for each setting of a model; lower and further left is better.";
    chart.x = {"seconds to predict", true};
    chart.y = {what, true};
    ChartSeries front{"Pareto front", kChartLooks - 1, ChartSeries::Style::kLine, {}};
    std::map<std::string, ChartSeries> by_model;
    for (const Trial& trial : trials()) {
      const std::optional<double> error = (this->*error_of)(*trial.judgement);
      if (!error) { continue; }
      ChartSeries& series = by_model[trial.model];
      series.name = trial.model;
      series.look = looks_.of(trial.model);
      series.style = ChartSeries::Style::kMarks;
      const ChartPoint at{trial.judgement->seconds, *error};
      series.points.push_back(at);
      front.points.push_back(at);
      // A model without knobs has no front to turn.
      if (trial.is_knee && !trial.knobs.empty()) {
        chart.labels.push_back({at, trial.is_default ? "knee" : "knee*"});
      }
    }
    keep_front(front.points);
    for (auto& [name, series] : by_model) { chart.series.push_back(std::move(series)); }
    chart.series.push_back(std::move(front));
    return chart;
  }

  // Ascending in x, each lower than all before it.
  static void keep_front(std::vector<ChartPoint>& points) {
    std::sort(points.begin(), points.end(), [](const ChartPoint& a, const ChartPoint& b) {
      return a.x != b.x ? a.x < b.x : a.y < b.y;
    });
    std::vector<ChartPoint> front;
    for (const ChartPoint& point : points) {
      if (front.empty() || point.y < front.back().y) { front.push_back(point); }
    }
    points = std::move(front);
  }

  [[nodiscard]] std::string speed() {
    std::string html =
        "<h2>Speed against error</h2>\n<p>The knee of a model's settings is the one farthest below "
        "the straight line from its fastest to its most accurate on these logarithmic axes, with "
        "1 \u2212 R\u00b2 as the error. What is 0 lies on the lower edge.";
    for (const Trial& trial : trials()) {
      if (!trial.is_knee || trial.knobs.empty()) { continue; }
      html += fmt::format(" Knee of {}: {}, which is {}the default.", escape_markup(trial.model),
                          escape_markup(trial.knobs), trial.is_default ? "" : "not ");
    }
    html += "</p>\n<div class=\"pair\">\n";
    html += figure_html(speed_chart("1 - R\u00b2", &Page::unexplained_error),
                        "Variance of the estimates that the line through the counts leaves.");
    html += figure_html(speed_chart("sigma / mean r", &Page::sigma_error),
                        "Scatter about the line in units of the mean count.");
    if (record_.oracle) {
      html += figure_html(speed_chart("capture lost at 25 % of bytes", &Page::lost_capture),
                          "Share of the accesses that the best choice would have captured.");
    }
    html += "</div>\n";
    std::vector<Row> rows;
    for (const Trial& trial : trials()) {
      Row row{fmt::format("{} {}", trial.model, trial.knobs),
              fmt::format("{:.4f}", trial.judgement->seconds),
              digits(unexplained(trial.judgement->all), 4),
              text_of(trial.judgement->all.sigma_over_mean),
              text_of(lost_capture(*trial.judgement))};
      row.push_back(std::string(trial.is_default ? "default" : "") +
                    (trial.is_on_front ? " front" : "") + (trial.is_knee ? " knee" : ""));
      rows.push_back(row);
    }
    return html + table_html("Every setting tried",
                             {"setting", "seconds", "1 - R\u00b2", "sigma / mean r",
                              "capture lost at 25 %", ""},
                             rows);
  }

  [[nodiscard]] Chart fit_chart(const ModelResult& model, bool primary) {
    Chart chart;
    chart.title = fmt::format("{}: estimated against counted {} rays", model.name,
                              primary ? "primary" : "all");
    chart.description =
        "One dot for each " + record_.unit + "; the dotted line is where estimate and count agree.";
    chart.x = {"counted", true};
    chart.y = {"estimated", true};
    chart.has_diagonal = true;
    ChartSeries& series = chart.series.emplace_back();
    series.name = model.name;
    series.look = looks_.of(model.name);
    series.style = ChartSeries::Style::kDots;
    const std::vector<double>& e = primary ? model.estimated.camera : model.estimated.all;
    const std::vector<double>& r = primary ? record_.counted.camera : record_.counted.all;
    for (std::size_t cell = 0; cell < r.size(); ++cell) {
      series.points.push_back({r[cell], e[cell]});
    }
    return chart;
  }

  [[nodiscard]] static std::string fit_caption(const char* which, const Evaluation& fit) {
    return fmt::format("{} rays: e = {} + {} r, sigma {}, Pearson {}.", which, text_of(fit.alpha),
                       text_of(fit.beta), text_of(fit.sigma), text_of(fit.pearson));
  }

  [[nodiscard]] std::string fits() {
    std::string html =
        "<h2>Fits</h2>\n<p>Both axes are logarithmic; a count or estimate of 0 lies on the edge."
        "</p>\n";
    for (const ModelResult& model : record_.models) {
      html += fmt::format("<h3>{}</h3>\n<div class=\"pair\">\n", escape_markup(model.name));
      html += figure_html(fit_chart(model, true), fit_caption("Primary", model.judgement.camera));
      html += figure_html(fit_chart(model, false), fit_caption("All", model.judgement.all));
      html += "</div>\n";
    }
    return html;
  }

  static std::vector<ChartPoint> curve_of(const std::vector<double>& rays) {
    const std::size_t group = (rays.size() + kCurvePointsMax - 1) / kCurvePointsMax;
    std::vector<ChartPoint> points;
    for (std::size_t begin = 0; begin < rays.size(); begin += group) {
      const std::size_t end = std::min(rays.size(), begin + group);
      double sum = 0.0;
      for (std::size_t cell = begin; cell < end; ++cell) { sum += rays[cell]; }
      points.push_back({static_cast<double>(begin), sum / static_cast<double>(end - begin)});
    }
    return points;
  }

  // A few cells that see most rays would press all others to the axis.
  static bool is_steep(const std::vector<double>& rays) {
    double sum = 0.0;
    double most = 0.0;
    for (const double value : rays) {
      sum += value;
      most = std::max(most, value);
    }
    return most * static_cast<double>(rays.size()) > 50.0 * sum;
  }

  [[nodiscard]] Chart curve_chart(const ModelResult& model, bool primary) const {
    Chart chart;
    chart.title = fmt::format("{}: {} rays per {}, estimated and counted", model.name,
                              primary ? "primary" : "all", record_.unit);
    chart.description = "Two curves over the numbers of the cells; neighbours are close in space.";
    chart.x = {record_.unit + " number"};
    chart.y = {"rays"};
    const CellRays& e = model.estimated;
    const CellRays& r = record_.counted;
    chart.y.logarithmic = is_steep(primary ? r.camera : r.all);
    chart.series.push_back(
        {"counted", 0, ChartSeries::Style::kLine, curve_of(primary ? r.camera : r.all)});
    chart.series.push_back(
        {"estimated", 1, ChartSeries::Style::kLine, curve_of(primary ? e.camera : e.all)});
    return chart;
  }

  [[nodiscard]] std::string curves() const {
    const std::size_t cells = record_.counted.all.size();
    const std::size_t group = (cells + kCurvePointsMax - 1) / kCurvePointsMax;
    std::string html = fmt::format(
        "<h2>Rays along the scene</h2>\n<p>As figure 6 of Reinhard, Kok and Chalmers (1998): "
        "primary rays on the left, all rays on the right{}. The axis of rays is logarithmic where "
        "a "
        "cell sees more than fifty times the mean.</p>\n",
        group > 1 ? fmt::format("; each point is the mean of {} neighbours", group)
                  : std::string());
    for (const ModelResult& model : record_.models) {
      html += fmt::format("<h3>{}</h3>\n<div class=\"pair\">\n", escape_markup(model.name));
      html += figure_html(curve_chart(model, true), "Primary rays.");
      html += figure_html(curve_chart(model, false), "All rays.");
      html += "</div>\n";
    }
    return html;
  }

  [[nodiscard]] std::string ablation() const {
    std::vector<Row> rows;
    for (const AblationResult& result : record_.ablation) {
      rows.push_back(model_row(result.model + " without " + result.term, result.judgement));
    }
    return "<h2>What each term is worth</h2>\n" +
           table_html(
               "Models that were handed the scene without one of its terms, judged by the "
               "rays of the whole scene",
               model_heading("model"), rows);
  }

  const EvaluationRecord& record_;
  Looks looks_;
};

}  // namespace

std::string make_evaluation_page(const EvaluationRecord& record) { return Page(record).html(); }

}  // namespace preheat
