// Time as an argument: who decides gets a Time, who loops asks the clock.
//
// Only the steady clock; the wall clock is printed, never compared.
#pragma once

#include <algorithm>
#include <chrono>
#include <cstdlib>

namespace preheat {

using Clock = std::chrono::steady_clock;
using Time = Clock::time_point;
using Duration = Clock::duration;

[[nodiscard]] inline double seconds(Duration duration) {
  return std::chrono::duration<double>(duration).count();
}

[[nodiscard]] inline Duration from_seconds(double value) {
  return std::chrono::duration_cast<Duration>(std::chrono::duration<double>(value));
}

// The environment variable PREHEAT_TIME_SCALE divides every protocol timer, so that tests of faults
// end in seconds. 1 where it is not set or not in [0.01, 1000].
[[nodiscard]] inline double time_scale() {
  const char* text = std::getenv("PREHEAT_TIME_SCALE");
  const double value = text == nullptr ? 1.0 : std::atof(text);
  return value >= 0.01 && value <= 1000.0 ? value : 1.0;
}

// Every timer of the protocol in one place.
struct Timers {
  Duration heartbeat = std::chrono::seconds(1);
  Duration suspect = std::chrono::seconds(3);          // silent worker: no new leases
  Duration dead = std::chrono::seconds(5);             // silent worker: its leases go to others
  Duration lease_min = std::chrono::seconds(10);       // without progress
  Duration fetch = std::chrono::seconds(5);            // a range request without any reply
  Duration fetch_max = std::chrono::seconds(30);       // its back-off ends here
  Duration peer = std::chrono::milliseconds(500);      // a peer that was asked and says nothing
  Duration peer_max = std::chrono::seconds(60);        // it is not asked for so long at most
  Duration plan_gap = std::chrono::milliseconds(500);  // between two plans of homes
  Duration hello_retry = std::chrono::seconds(2);
  Duration tick_gap = std::chrono::seconds(3);    // the master itself was stopped
  Duration farewell = std::chrono::seconds(2);    // waiting for last words
  Duration kill_grace = std::chrono::seconds(3);  // from SIGTERM to SIGKILL of our children
  Duration waiting_notice = std::chrono::seconds(10);

  [[nodiscard]] Timers scaled(double scale) const {
    const auto shorter = [scale](Duration duration) {
      return from_seconds(seconds(duration) / scale);
    };
    Timers timers = *this;
    for (Duration* duration :
         {&timers.heartbeat, &timers.suspect, &timers.dead, &timers.lease_min, &timers.fetch,
          &timers.fetch_max, &timers.peer, &timers.peer_max, &timers.plan_gap, &timers.hello_retry,
          &timers.tick_gap, &timers.farewell, &timers.kill_grace, &timers.waiting_notice}) {
      *duration = shorter(*duration);
    }
    // A busy machine lets a process wait so long without being stopped.
    timers.tick_gap = std::max<Duration>(timers.tick_gap, std::chrono::milliseconds(500));
    return timers;
  }
};

}  // namespace preheat
