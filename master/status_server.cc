#include "master/status_server.h"

#include <fmt/format.h>

#include <utility>

#include "master/status_page.h"

namespace preheat {
namespace {

// The loop looks up ten times a second; a debugger or a swapped-out machine keeps it from that.
constexpr double kSilentSeconds = 5.0;

HttpResponse file_response(const char* type, std::string content) {
  return {200, type, std::make_shared<const std::string>(std::move(content))};
}

}  // namespace

StatusServer::StatusServer(const StatusFacts& facts, double exposure_ev)
    : facts_(facts),
      preview_(facts.width, facts.height, exposure_ev),
      moment_(std::make_shared<const Moment>(Moment{{}, Clock::now()})) {}

StatusServer::~StatusServer() = default;

Result<std::unique_ptr<StatusServer>> StatusServer::start(const Endpoint& listen,
                                                          const StatusFacts& facts,
                                                          double exposure_ev) {
  std::unique_ptr<StatusServer> status(new StatusServer(facts, exposure_ev));
  auto server = HttpServer::start(
      listen, [raw = status.get()](const HttpRequest& request) { return raw->answer(request); });
  if (!server) { return tl::unexpected(server.error()); }
  status->server_ = *std::move(server);
  return status;
}

void StatusServer::look(RenderSnapshot snapshot) {
  auto moment = std::make_shared<const Moment>(Moment{std::move(snapshot), Clock::now()});
  const std::lock_guard lock(mutex_);
  moment_.swap(moment);
}

void StatusServer::tile_done(const TileRect& rect, const TilePixels& pixels) {
  preview_.assign(rect, pixels);
}

std::string StatusServer::url() const {
  const Endpoint& endpoint = server_->endpoint();
  return fmt::format("http://{}:{}/", endpoint.host, endpoint.port);
}

std::shared_ptr<const StatusServer::Moment> StatusServer::moment() const {
  const std::lock_guard lock(mutex_);
  return moment_;
}

HttpResponse StatusServer::health() const {
  const double silent = seconds(Clock::now() - moment()->at);
  if (silent < kSilentSeconds) { return text_response(200, "ok\n"); }
  return text_response(503, fmt::format("the render's loop stands still for {:.0f} s\n", silent));
}

HttpResponse StatusServer::answer(const HttpRequest& request) {
  using Json = nlohmann::ordered_json;
  if (request.path == "/") {
    return file_response("text/html; charset=utf-8", std::string(kStatusPageHtml));
  }
  if (request.path == "/status.css") {
    return file_response("text/css; charset=utf-8", status_page_style());
  }
  if (request.path == "/status.js") {
    return file_response("text/javascript; charset=utf-8", std::string(kStatusPageScript));
  }
  if (request.path == "/icon.svg") {
    return file_response("image/svg+xml", std::string(kStatusPageIcon));
  }
  if (request.path == "/status.json") {
    const Json json = make_status_json(facts_, moment()->snapshot, preview_.version());
    return file_response("application/json",
                         json.dump(-1, ' ', false, Json::error_handler_t::replace) + "\n");
  }
  if (request.path == "/image.jpg") { return {200, "image/jpeg", preview_.jpeg()}; }
  if (request.path == "/metrics") {
    return file_response("text/plain; version=0.0.4; charset=utf-8",
                         make_metrics(facts_, moment()->snapshot));
  }
  if (request.path == "/healthz") { return health(); }
  return text_response(404, "there are /, /status.json, /image.jpg, /metrics and /healthz\n");
}

Result<Endpoint> check_status_address(const std::string& text, bool anyone_may_look) {
  Result<Endpoint> endpoint = parse_endpoint("tcp://" + text);
  if (!endpoint) {
    return fail(ExitCode::kUsage,
                fmt::format("bad address \"{}\": expected HOST:PORT such as 127.0.0.1:8080", text));
  }
  if (!anyone_may_look && !is_loopback(*endpoint)) {
    return fail(ExitCode::kUsage,
                fmt::format("{} is not a loopback address, and the status page shows image and "
                            "scene to whoever reaches it: give --insecure-status to allow that",
                            text));
  }
  return endpoint;
}

}  // namespace preheat
