// Serves a page that is only looked at, on one thread that gives way to the render.
//
// Bounded whatever clients do: so many connections, in all and of one address, each with one
// request whose head has a limit, and so many seconds for all of it. Where there is no room a new
// client takes the place of the oldest that has had its time, so that silent or slow ones cannot
// keep others out; of an address that has all its places and gives up none, it gets a 503.
//
// Debian 12's cpp-httplib (0.11.4) could not keep these bounds: it limits the length of a header
// field but not how many there are, gives a client as long as it goes on sending bytes, holds a
// thread for each that does, and queues the others without limit.
#pragma once

#include <functional>
#include <memory>

#include "common/result.h"
#include "common/transport.h"
#include "master/http_admission.h"
#include "master/http_message.h"

namespace preheat {

class HttpServer {
 public:
  // Called on the server's thread, one request after the other.
  using Handler = std::function<HttpResponse(const HttpRequest&)>;

  // Port 0 takes any free one. kUsage if the address cannot be listened at.
  [[nodiscard]] static Result<std::unique_ptr<HttpServer>> start(const Endpoint& listen,
                                                                 Handler handler,
                                                                 const HttpLimits& limits = {});
  ~HttpServer();  // closes every connection
  HttpServer(const HttpServer&) = delete;
  HttpServer& operator=(const HttpServer&) = delete;

  [[nodiscard]] const Endpoint& endpoint() const;

 private:
  class Impl;
  explicit HttpServer(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace preheat
