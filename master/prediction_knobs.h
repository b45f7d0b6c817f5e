// The knobs of the prediction models as command-line options.
#pragma once

#include <string>

#include "cache/prediction.h"
#include "common/result.h"

namespace CLI {
class App;
}

namespace preheat {

struct BinCounts {
  unsigned polar = 0;
  unsigned azimuth = 0;
};

// "6x12": rows of polar angle and columns of azimuth.
[[nodiscard]] Result<BinCounts> parse_bin_counts(const std::string& text);
// "ratio", "printed" or "arrival".
[[nodiscard]] Result<PaperOcclusion> parse_paper_occlusion(const std::string& text);

// `knobs` holds the defaults and must outlive the parsing.
void add_prediction_knobs(CLI::App& app, PredictionKnobs& knobs);

}  // namespace preheat
