#include <fmt/format.h>

#include <array>
#include <chrono>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>

#include "common/clock.h"
#include "common/codec.h"
#include "common/secure_transport.h"
#include "common/zmq_transport.h"
#include "master/command_line.h"
#include "master/commands.h"

namespace preheat {
namespace {

constexpr std::chrono::milliseconds kBetweenRequests{500};
constexpr std::chrono::milliseconds kTurn{20};

struct StatusOptions {
  std::string connect{};
  std::string json{};
  double timeout_seconds = 3.0;
  SecurityOptions security{};
};

const char* name_of(JobPhase phase) {
  switch (phase) {
    case JobPhase::kWaiting:
      return "waiting";
    case JobPhase::kRendering:
      return "rendering";
    case JobPhase::kFarewell:
      return "ending";
    case JobPhase::kOver:
      return "over";
  }
  return "over";
}

// What came to the channel: the status, nothing yet, or an error that ends the asking.
Result<std::optional<Status>> take_answer(Channel& channel) {
  while (const std::optional<Received> received = channel.receive()) {
    const auto frame = decode_frame(received->head.bytes);
    if (!frame) {
      if (frame.error().fault != FrameFault::kVersion) { continue; }
      return fail(ExitCode::kMismatch,
                  fmt::format("the master speaks protocol version {}, this program speaks {}",
                              frame.error().version, kProtocolVersion));
    }
    if (const auto* status = std::get_if<Status>(&frame->message)) { return *status; }
  }
  return std::nullopt;
}

Result<Status> ask(const StatusOptions& options) {
  Result<SecureTransport> opened =
      open_transport(options.connect, options.security, KeyRole::kMaster);
  if (!opened) { return tl::unexpected(opened.error()); }
  Transport& transport = *opened->transport;
  const auto channel =
      transport.connect(opened->endpoint.text(), ChannelKind::kControl, random_session());
  if (!channel) { return tl::unexpected(channel.error()); }
  const Time end = Clock::now() + from_seconds(options.timeout_seconds);
  std::optional<Time> asked_last;
  for (Time now = Clock::now(); now < end; now = Clock::now()) {
    Result<std::optional<Status>> answer = take_answer(**channel);
    if (!answer) { return tl::unexpected(answer.error()); }
    if (*answer) { return **answer; }
    if (const std::string& reason = (*channel)->handshakes().refused; !reason.empty()) {
      return fail(ExitCode::kMasterGone,
                  fmt::format("the master at {} refused: {}", options.connect, reason));
    }
    if (!asked_last || now - *asked_last >= kBetweenRequests) {
      const auto sent = (*channel)->send({}, encode_frame({}, StatusRequest{}), {});
      if (sent == SendOutcome::kSent) { asked_last = now; }
    }
    const std::array<Channel*, 1> channels{channel->get()};
    transport.wait(channels, -1, kTurn);
  }
  // The other side may hang up before it has let us know why.
  const char* suspicion = "";
  if ((*channel)->handshakes().broken > 0) {
    suspicion = options.security.keys_folder.empty()
                    ? ": something is there, but perhaps only one of both sides has keys"
                    : ": something is there, but not this master's key";
  }
  return fail(ExitCode::kMasterGone,
              fmt::format("no master answers at {} within {:g} seconds{}", options.connect,
                          options.timeout_seconds, suspicion));
}

std::optional<double> hit_rate_of(const Status& status) {
  if (status.accesses == 0) { return std::nullopt; }
  return std::max(0.0,
                  1.0 - static_cast<double>(status.misses) / static_cast<double>(status.accesses));
}

std::string json_of(const Status& status) {
  nlohmann::ordered_json json = {
      {"version", status.build.text},
      {"phase", name_of(status.phase)},
      {"tiles", {{"done", status.tiles_done}, {"total", status.tiles_total}}},
      {"workers",
       {{"here", status.workers}, {"ready", status.workers_ready}, {"lost", status.workers_lost}}},
      {"leases_expired", status.leases_expired},
      {"rays", status.rays},
      {"hit_rate", nullptr},
      {"waiting_seconds", status.waiting_seconds},
      {"rendering_seconds", status.rendering_seconds}};
  if (const auto hit_rate = hit_rate_of(status)) { json["hit_rate"] = *hit_rate; }
  return json.dump(2) + "\n";
}

std::string text_of(const Status& status) {
  const auto hit_rate = hit_rate_of(status);
  return fmt::format(
      "phase    {} for {:.1f} s\n"
      "tiles    {} of {}\n"
      "workers  {} here, {} ready, {} lost\n"
      "rays     {:.2f} M\n"
      "cache    hit rate {}\n",
      name_of(status.phase),
      status.phase == JobPhase::kWaiting ? status.waiting_seconds : status.rendering_seconds,
      status.tiles_done, status.tiles_total, status.workers, status.workers_ready,
      status.workers_lost, static_cast<double>(status.rays) * 1e-6,
      hit_rate ? fmt::format("{:.3f}%", 100.0 * *hit_rate) : "not known");
}

Result<void> show_status(const StatusOptions& options) {
  if (auto writable = check_text_output(options.json); !writable) { return writable; }
  const Result<Status> status = ask(options);
  if (!status) { return tl::unexpected(status.error()); }
  if (options.json.empty()) { return write_text_output("-", text_of(*status)); }
  return write_text_output(options.json, json_of(*status));
}

}  // namespace

void add_status_command(CLI::App& app, Command& chosen) {
  const auto options = std::make_shared<StatusOptions>();
  CLI::App* const command =
      app.add_subcommand("status", "Ask a running master how far it is; 4 if none answers");
  add_parsed_option(*command, "--connect", options->connect, &parse_address,
                    "The master's address, as its --listen names it")
      ->required()
      ->type_name("tcp://HOST:PORT");
  command->add_option("--json", options->json, "Write it here as JSON; - for stdout")
      ->type_name("FILE");
  command->add_option("--timeout", options->timeout_seconds, "Give up after so many seconds")
      ->check(in_range(0.1, 3600.0))
      ->type_name("SECONDS")
      ->capture_default_str();
  auto* const insecure = command->add_flag(
      "--insecure-no-auth", options->security.insecure_no_auth,
      "Allow an address that is not loopback without keys: nothing is encrypted or authenticated");
  add_keys_option(*command, options->security)->excludes(insecure);
  command->footer("With keys, only the master's own key (in DIR/master) may ask.");
  command->callback([&chosen, options] { chosen = [options] { return show_status(*options); }; });
}

}  // namespace preheat
