// The live page of a render: a page that polls, the JSON it polls, the image so far, metrics and a
// health check. Read-only, and everything beside the page's own files is made when somebody asks.
//
//   loop of the render -> snapshot, preview  |  thread of the HTTP server -> answers
//
// The loop hands over a snapshot about ten times a second and copies tiles into a small preview;
// what takes time is done by the server's thread, which gives way to the render.
#pragma once

#include <memory>
#include <mutex>
#include <string>

#include "common/clock.h"
#include "master/http_server.h"
#include "master/preview_image.h"
#include "master/render_watch.h"
#include "master/status_text.h"

namespace preheat {

class StatusServer : public RenderWatch {
 public:
  [[nodiscard]] static Result<std::unique_ptr<StatusServer>> start(const Endpoint& listen,
                                                                   const StatusFacts& facts,
                                                                   double exposure_ev);
  ~StatusServer() override;

  void look(RenderSnapshot snapshot) override;
  void tile_done(const TileRect& rect, const TilePixels& pixels) override;

  // "http://127.0.0.1:8080/".
  [[nodiscard]] std::string url() const;

  // Pure but for the clock; called by the server.
  [[nodiscard]] HttpResponse answer(const HttpRequest& request);

 private:
  StatusServer(const StatusFacts& facts, double exposure_ev);

  struct Moment {
    RenderSnapshot snapshot{};
    Time at{};
  };
  [[nodiscard]] std::shared_ptr<const Moment> moment() const;
  [[nodiscard]] HttpResponse health() const;

  StatusFacts facts_;
  PreviewImage preview_;
  mutable std::mutex mutex_;  // of moment_, held for the copy of a pointer
  std::shared_ptr<const Moment> moment_;
  std::unique_ptr<HttpServer> server_;  // last: its thread ends first
};

// HOST:PORT as the user writes it. kUsage if it is none, or if it is not loopback and
// `anyone_may_look` was not spelled out: the page asks nobody who they are.
[[nodiscard]] Result<Endpoint> check_status_address(const std::string& text, bool anyone_may_look);

}  // namespace preheat
