// Helpers of those who declare options. What is declared elsewhere only names CLI::App: the library
// is header-only and costs each file that includes it seconds.
#pragma once

#include <CLI/CLI.hpp>
#include <string>
#include <utility>

#include "common/result.h"
#include "master/options.h"

namespace preheat {

// An option whose text `parse` turns into `target`; a parse error is the option's.
template <class Target, class Value>
CLI::Option* add_parsed_option(CLI::App& app, const std::string& name, Target& target,
                               Result<Value> (*parse)(const std::string&),
                               const std::string& help) {
  const auto set = [&target, parse, name](const std::string& text) {
    Result<Value> value = parse(text);
    if (!value) { throw CLI::ValidationError(name, value.error().message); }
    target = *std::move(value);
  };
  return app.add_option_function<std::string>(name, set, help);
}

// A check whose limits the help does not spell out beside every option.
template <class Number>
CLI::Validator in_range(Number low, Number high) {
  return CLI::Range(low, high).description("");
}

// --keys, or the environment's PREHEAT_KEYS.
CLI::Option* add_keys_option(CLI::App& app, SecurityOptions& security);

}  // namespace preheat
