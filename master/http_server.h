// Serves a page that is only looked at, on one thread that gives way to the render.
//
// Bounded whatever clients do: so many connections, each with one request whose head has a limit,
// and so many seconds for all of it. When there is no room a new client takes the place of the
// oldest that has had its time, so that silent or slow ones cannot keep others out.
//
// Debian 12's cpp-httplib (0.11.4) could not keep these bounds: it limits the length of a header
// field but not how many there are, gives a client as long as it goes on sending bytes, holds a
// thread for each that does, and queues the others without limit.
#pragma once

#include <chrono>
#include <cstddef>
#include <functional>
#include <memory>
#include <string>

#include "common/result.h"
#include "common/transport.h"
#include "master/http_message.h"

namespace preheat {

struct HttpLimits {
  std::size_t connections_max = 32;
  std::chrono::milliseconds connection_max{10000};  // from accepted to closed
  std::chrono::milliseconds patience{500};          // after which a connection may lose its place
};

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
