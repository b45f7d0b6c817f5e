// What preheat_cluster_bench measured, as one self-contained HTML page: the curves and their
// tables.
#pragma once

#include <nlohmann/json.hpp>
#include <string>

namespace preheat {

// `measured`: what the program writes as JSON.
[[nodiscard]] std::string make_bench_page(const nlohmann::ordered_json& measured);

}  // namespace preheat
