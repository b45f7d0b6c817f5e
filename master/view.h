// The settings of a render: what the user asked for, completed by what the scene offers.
#pragma once

#include <string>
#include <vector>

#include "common/render_settings.h"
#include "common/result.h"
#include "common/scene.h"
#include "common/scene_tables.h"
#include "master/options.h"

namespace preheat {

struct ResolvedView {
  RenderSettings settings{};
  Camera camera{};              // what settings.view was made of
  std::string camera_source{};  // e.g. "camera 0 'front'" or "framed"
  std::string sky_source{};     // "option", "none: the scene has lights" or "default: ..."
};

// An unknown camera, an eye at the point it looks at, or an upward direction along the view is a
// usage error.
[[nodiscard]] Result<ResolvedView> resolve_view(const SceneTables& tables,
                                                const std::vector<Camera>& cameras,
                                                const ViewOptions& options);

}  // namespace preheat
