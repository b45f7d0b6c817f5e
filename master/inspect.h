// What `preheat inspect` says of a store: as text and as JSON.
#pragma once

#include <nlohmann/json.hpp>
#include <string>

#include "common/store.h"

namespace preheat {

// Several lines: import, the rows of [P] Table 1 and the averages of its section 2, voxels and
// their sizes, the bytes of each section.
[[nodiscard]] std::string describe_store(const Store& store);

// The same figures, in SI units and bytes.
[[nodiscard]] nlohmann::json store_json(const Store& store);

}  // namespace preheat
