// The files of the live page. They hold no data: the script polls /status.json and /image.jpg.
#pragma once

#include <string>
#include <string_view>

namespace preheat {

extern const std::string_view kStatusPageHtml;
extern const std::string_view kStatusPageScript;
extern const std::string_view kStatusPageIcon;  // SVG
// The style of all pages and what this one adds.
[[nodiscard]] std::string status_page_style();

}  // namespace preheat
