#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cmath>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>

#include "master/commands.h"
#include "master/image_compare.h"

namespace preheat {
namespace {

struct CompareOptions {
  std::string image{};
  std::string reference{};
  std::string json{};
};

std::string difference_table(const ImageDifference& difference) {
  return fmt::format(
      "pixels differing  {} of {}\n"
      "mse               {:.9g}\n"
      "rmse              {:.9g}\n"
      "max abs           {:.9g}\n"
      "relative mse      {:.9g}\n"
      "psnr              {:.4f} dB\n",
      difference.pixels_differing, difference.pixels, difference.mse, difference.rmse,
      difference.max_abs, difference.relative_mse, difference.psnr_db);
}

// JSON has no infinity: an infinite value is null.
nlohmann::ordered_json finite_or_null(double value) {
  return std::isfinite(value) ? nlohmann::ordered_json(value) : nlohmann::ordered_json(nullptr);
}

std::string difference_json(const ImageDifference& difference) {
  const nlohmann::ordered_json json = {{"pixels", difference.pixels},
                                       {"pixels_differing", difference.pixels_differing},
                                       {"mse", finite_or_null(difference.mse)},
                                       {"rmse", finite_or_null(difference.rmse)},
                                       {"max_abs", finite_or_null(difference.max_abs)},
                                       {"relative_mse", finite_or_null(difference.relative_mse)},
                                       {"psnr_db", finite_or_null(difference.psnr_db)}};
  return json.dump(2) + "\n";
}

Result<void> compare(const CompareOptions& options) {
  if (auto writable = check_text_output(options.json); !writable) { return writable; }
  const auto image = read_image(options.image);
  if (!image) { return tl::unexpected(image.error()); }
  const auto reference = read_image(options.reference);
  if (!reference) { return tl::unexpected(reference.error()); }
  const auto difference = compare_images(*image, *reference);
  if (!difference) { return tl::unexpected(difference.error()); }
  if (options.json != "-") {
    if (auto printed = write_text_output("-", difference_table(*difference)); !printed) {
      return printed;
    }
  }
  return write_text_output(options.json, difference_json(*difference));
}

}  // namespace

void add_compare_command(CLI::App& app, Command& chosen) {
  const auto options = std::make_shared<CompareOptions>();
  CLI::App* const command =
      app.add_subcommand("compare", "Say how far two images of one size are apart");
  command->add_option("IMAGE", options->image, "PNG or EXR; PNG is decoded to linear")->required();
  command->add_option("REFERENCE", options->reference, "PNG or EXR")->required();
  command->add_option("--json", options->json, "Write the figures here too; - for stdout")
      ->type_name("FILE");
  command->footer(
      "Ends with 0 whenever both could be read, however far apart they are.\n"
      "Example: preheat compare out.exr reference.exr --json -");
  command->callback([&chosen, options] { chosen = [options] { return compare(*options); }; });
}

}  // namespace preheat
