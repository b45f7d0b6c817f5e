// Lets one thread sleep until others have something for it.
#pragma once

#include <chrono>
#include <condition_variable>
#include <mutex>

namespace preheat {

class Doorbell {
 public:
  // From any thread.
  void ring() {
    {
      const std::lock_guard lock(mutex_);
      rung_ = true;
    }
    condition_.notify_one();
  }
  // Returns when it has been rung since the last call, or when patience ends.
  void wait_for(std::chrono::milliseconds patience) {
    std::unique_lock lock(mutex_);
    condition_.wait_for(lock, patience, [this] { return rung_; });
    rung_ = false;
  }

 private:
  std::mutex mutex_;
  std::condition_variable condition_;
  bool rung_ = false;
};

}  // namespace preheat
