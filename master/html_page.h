// What preheat's pages have in common: a head with styles for light and dark, tables and figures.
// Self-contained: nothing is loaded from anywhere.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "master/svg_chart.h"

namespace preheat {

// From the doctype to the opening tag of <main>. `extra_style` is a page's own style sheet.
[[nodiscard]] std::string page_begin(std::string_view title, std::string_view extra_style = {});
[[nodiscard]] std::string page_end();

// The rules of every page, for those that do not begin with page_begin.
extern const std::string_view kPageStyle;

// The cells of a table, as plain text.
using TableRow = std::vector<std::string>;

// The first column heads its rows. Wide tables scroll, also by keyboard.
[[nodiscard]] std::string table_html(std::string_view caption, const TableRow& heading,
                                     const std::vector<TableRow>& rows);

[[nodiscard]] std::string figure_html(const Chart& chart, std::string_view caption);

}  // namespace preheat
