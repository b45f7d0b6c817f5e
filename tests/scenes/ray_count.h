// How many rays a test traces.
#pragma once

namespace preheat::test {

// Sanitizers make each ray dear: there a test traces a tenth of them.
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
inline constexpr int kRayShare = 10;
#else
inline constexpr int kRayShare = 1;
#endif

constexpr int ray_count(int rays) { return rays / kRayShare; }

}  // namespace preheat::test
