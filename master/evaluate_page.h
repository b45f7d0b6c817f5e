// What `preheat evaluate` found, as one HTML page for a person: charts with their numbers in tables
// beside them. Self-contained: no script, no network; light and dark; readable without the
// pictures.
#pragma once

#include <string>

#include "master/evaluation_record.h"

namespace preheat {

[[nodiscard]] std::string make_evaluation_page(const EvaluationRecord& record);

}  // namespace preheat
