#include "master/html_page.h"

#include <fmt/format.h>

namespace preheat {
namespace {

std::string cells_html(const TableRow& row, const char* tag, const char* first) {
  std::string html = "<tr>";
  for (std::size_t i = 0; i < row.size(); ++i) {
    html += i == 0 ? fmt::format("<{}>{}</th>", first, escape_markup(row[i]))
                   : fmt::format("<{0}>{1}</{2}>", tag, escape_markup(row[i]),
                                 std::string_view(tag).substr(0, 2));
  }
  return html + "</tr>\n";
}

}  // namespace

const std::string_view kPageStyle = R"css(
:root { color-scheme: light dark; --ink: #1b1f24; --paper: #ffffff; --grid: #d9dde3; --soft: #f3f5f8; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e6e9ee; --paper: #14171c; --grid: #3a414c; --soft: #1e232b; }
}
body { color: var(--ink); background: var(--paper); font: 16px/1.5 system-ui, sans-serif;
  max-width: 76rem; margin: 0 auto; padding: 1rem 1.5rem 4rem; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.25rem; margin-top: 2.5rem; } h3 { font-size: 1rem; }
.pair { display: flex; flex-wrap: wrap; gap: 1.5rem; }
figure { margin: 0.5rem 0; max-width: 100%; }
figcaption { font-size: 0.9rem; max-width: 30rem; }
.scroll { overflow-x: auto; margin: 0.75rem 0; }
.scroll:focus-visible { outline: 2px solid currentColor; }
table { border-collapse: collapse; font-size: 0.9rem; font-variant-numeric: tabular-nums; }
caption { text-align: left; padding: 0.25rem 0; }
th, td { padding: 0.2rem 0.6rem; border-bottom: 1px solid var(--grid); text-align: right; }
td { white-space: nowrap; }
th:first-child, td:first-child { text-align: left; }
thead th { background: var(--soft); }
)css";

std::string page_begin(std::string_view title, std::string_view extra_style) {
  return fmt::format(
      "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n"
      "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n"
      "<title>{}</title>\n<style>{}{}{}</style>\n</head>\n<body>\n<main>\n",
      escape_markup(title), kPageStyle, kChartStyle, extra_style);
}

std::string page_end() { return "</main>\n</body>\n</html>\n"; }

std::string table_html(std::string_view caption, const TableRow& heading,
                       const std::vector<TableRow>& rows) {
  std::string html = fmt::format(
      "<div class=\"scroll\" tabindex=\"0\" role=\"region\" aria-label=\"{0}\">\n<table>\n"
      "<caption>{0}</caption>\n<thead>{1}</thead>\n<tbody>\n",
      escape_markup(caption), cells_html(heading, "th scope=\"col\"", "th scope=\"col\""));
  for (const TableRow& row : rows) { html += cells_html(row, "td", "th scope=\"row\""); }
  return html + "</tbody>\n</table>\n</div>\n";
}

std::string figure_html(const Chart& chart, std::string_view caption) {
  return fmt::format("<figure>\n{}<figcaption>{}</figcaption>\n</figure>\n", make_svg(chart),
                     escape_markup(caption));
}

}  // namespace preheat
