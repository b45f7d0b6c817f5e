// A finished render as one HTML page for a person: the image, the heat of the voxels in it as
// predicted and as counted, and what every worker did over time. Self-contained: no script, no
// network; light and dark; the numbers stand in tables too.
#pragma once

#include <nlohmann/json.hpp>
#include <string>

#include "master/report.h"

namespace preheat {

// `report` is make_report(record), of which all settings are listed.
[[nodiscard]] std::string make_render_page(const RenderRecord& record,
                                           const nlohmann::ordered_json& report,
                                           double exposure_ev);

}  // namespace preheat
