// Mathematics whose bits are the same on every machine: + - * / sqrt and polynomials, never libm,
// whose sin, exp and others differ between versions. Needs
// -ffp-contract=off, which the build sets.
#pragma once

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>

#include "common/vec3.h"

namespace preheat {

inline constexpr float kPi = 3.14159265358979323846F;
inline constexpr float kInversePi = 0.31830988618379067154F;
inline constexpr double kPiDouble = 3.14159265358979323846;

struct SinCos {
  float sin = 0.0F;
  float cos = 1.0F;
};

// For |angle| <= pi/4, within 2 ulp (coefficients: Cephes, sinf.c).
[[nodiscard]] inline SinCos sin_cos_octant(float angle) {
  const float square = angle * angle;
  const float sin = ((-1.9515295891e-4F * square + 8.3321608736e-3F) * square - 1.6666654611e-1F) *
                        square * angle +
                    angle;
  const float cos =
      ((2.443315711809948e-5F * square - 1.388731625493765e-3F) * square + 4.166664568298827e-2F) *
          square * square -
      0.5F * square + 1.0F;
  return {sin, cos};
}

// Of 2 pi turns, for 0 <= turns < 2^20. The reduction to a quarter turn is exact.
[[nodiscard]] inline SinCos sin_cos_turns(float turns) {
  const auto quarter = static_cast<std::int32_t>(turns * 4.0F + 0.5F);
  const float rest = turns - static_cast<float>(quarter) * 0.25F;
  const SinCos octant = sin_cos_octant(rest * (2.0F * kPi));
  switch (quarter & 3) {
    case 0:
      return octant;
    case 1:
      return {octant.cos, -octant.sin};
    case 2:
      return {-octant.sin, -octant.cos};
    default:
      return {-octant.cos, octant.sin};
  }
}

namespace detail {

// sin and cos for |x| <= pi/4 (coefficients: fdlibm, k_sin.c and k_cos.c).
[[nodiscard]] inline double sin_octant(double x) {
  const double z = x * x;
  const double tail = 8.33333333332248946124e-03 +
                      z * (-1.98412698298579493134e-04 +
                           z * (2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 +
                                                                  z * 1.58969099521155010221e-10)));
  return x + z * x * (-1.66666666666666324348e-01 + z * tail);
}

[[nodiscard]] inline double cos_octant(double x) {
  const double z = x * x;
  const double tail =
      4.16666666666666019037e-02 +
      z * (-1.38888888888741095749e-03 +
           z * (2.48015872894767294178e-05 +
                z * (-2.75573143513906633035e-07 +
                     z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11))));
  const double half = 0.5 * z;
  const double rounded = 1.0 - half;
  return rounded + (((1.0 - rounded) - half) + z * z * tail);
}

struct QuarterTurns {
  std::int64_t count = 0;
  double rest = 0.0;  // [rad], |rest| <= pi/4 up to rounding
};

// Cody-Waite reduction by pi/2 in two parts; good to about 1e-16 |x| for |x| <= 1e5.
[[nodiscard]] inline QuarterTurns reduce(double x) {
  const double turns = x * 6.36619772367581382433e-01;
  const auto count = static_cast<std::int64_t>(turns + (turns < 0.0 ? -0.5 : 0.5));
  const double n = static_cast<double>(count);
  return {count, (x - n * 1.57079632673412561417e+00) - n * 6.07710050650619224932e-11};
}

}  // namespace detail

// Radians, |x| <= 1e5; absolute error below 1e-15 + 1e-16 |x|.
[[nodiscard]] inline double sin_of(double x) {
  const detail::QuarterTurns turns = detail::reduce(x);
  const double value =
      (turns.count & 1) != 0 ? detail::cos_octant(turns.rest) : detail::sin_octant(turns.rest);
  return (turns.count & 2) != 0 ? -value : value;
}

[[nodiscard]] inline double cos_of(double x) {
  const detail::QuarterTurns turns = detail::reduce(x);
  const double value =
      (turns.count & 1) != 0 ? detail::sin_octant(turns.rest) : detail::cos_octant(turns.rest);
  return ((turns.count + 1) & 2) != 0 ? -value : value;
}

// e^x within 1 ulp where the result is normal; 0 below -708, infinity above 709 (coefficients:
// fdlibm, e_exp.c).
[[nodiscard]] inline double exp_of(double x) {
  if (std::isnan(x)) { return x; }
  if (x < -708.0) { return 0.0; }
  if (x > 709.0) { return std::numeric_limits<double>::infinity(); }
  const double steps = x * 1.44269504088896338700;
  const auto power = static_cast<std::int64_t>(steps + (steps < 0.0 ? -0.5 : 0.5));
  const double n = static_cast<double>(power);
  const double high = x - n * 6.93147180369123816490e-01;
  const double low = n * 1.90821492927058770002e-10;
  const double rest = high - low;
  const double z = rest * rest;
  const double even =
      rest - z * (1.66666666666666019037e-01 +
                  z * (-2.77777777770155933842e-03 +
                       z * (6.61375632143793436117e-05 +
                            z * (-1.65339022054652515390e-06 + z * 4.13813679705723846039e-08))));
  const double mantissa = 1.0 - ((low - (rest * even) / (2.0 - even)) - high);
  return mantissa * std::bit_cast<double>(static_cast<std::uint64_t>(power + 1023) << 52U);
}

// Natural logarithm of a normal positive number, within 1 ulp; -infinity for zero and subnormal
// numbers, NaN below (coefficients: fdlibm, e_log.c).
[[nodiscard]] inline double log_of(double x) {
  if (!(x >= 0.0)) { return std::numeric_limits<double>::quiet_NaN(); }
  if (x < std::numeric_limits<double>::min()) { return -std::numeric_limits<double>::infinity(); }
  if (x > std::numeric_limits<double>::max()) { return x; }
  const auto bits = std::bit_cast<std::uint64_t>(x);
  auto power = static_cast<std::int64_t>(bits >> 52U) - 1023;
  double mantissa = std::bit_cast<double>((bits & 0xFFFFFFFFFFFFFULL) | 0x3FF0000000000000ULL);
  if (mantissa > 1.41421356237309504880) {
    mantissa *= 0.5;
    ++power;
  }
  const double f = mantissa - 1.0;
  const double s = f / (2.0 + f);
  const double z = s * s;
  const double series =
      z * (6.666666666666735130e-01 +
           z * (3.999999999940941908e-01 +
                z * (2.857142874366239149e-01 +
                     z * (2.222219843214978396e-01 +
                          z * (1.818357216161805012e-01 +
                               z * (1.531383769920937332e-01 + z * 1.479819860511658591e-01))))));
  const double half_square = 0.5 * f * f;
  const double n = static_cast<double>(power);
  return n * 6.93147180369123816490e-01 -
         ((half_square - (s * (half_square + series) + n * 1.90821492927058770002e-10)) - f);
}

// base^exponent for base >= 0; relative error about 1e-16 (1 + |exponent log base|).
[[nodiscard]] inline double pow_of(double base, double exponent) {
  if (exponent == 0.0) { return 1.0; }
  return exp_of(exponent * log_of(base));
}

[[nodiscard]] inline float max_component(const Vec3& v) {
  return std::max(v.x, std::max(v.y, v.z));
}
[[nodiscard]] inline float mean_component(const Vec3& v) { return (v.x + v.y + v.z) / 3.0F; }

// Rec. 709.
[[nodiscard]] inline double luminance(const Vec3& rgb) {
  return 0.2126 * static_cast<double>(rgb.x) + 0.7152 * static_cast<double>(rgb.y) +
         0.0722 * static_cast<double>(rgb.z);
}

[[nodiscard]] inline bool is_finite(const Vec3& v) {
  return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z);
}

// The neighbouring float away from zero in the direction of `sign_of`; `value` itself where that is
// zero.
[[nodiscard]] inline float next_float_towards(float value, float sign_of) {
  if (sign_of == 0.0F || !std::isfinite(value)) { return value; }
  if (value == 0.0F) {
    return sign_of > 0.0F ? std::numeric_limits<float>::min() : -std::numeric_limits<float>::min();
  }
  const auto bits = std::bit_cast<std::uint32_t>(value);
  return std::bit_cast<float>((value > 0.0F) == (sign_of > 0.0F) ? bits + 1U : bits - 1U);
}

// Right-handed and orthonormal around a unit normal (Duff et al., JCGT 2017).
struct OrthonormalFrame {
  Vec3 tangent{1.0F, 0.0F, 0.0F};
  Vec3 bitangent{0.0F, 1.0F, 0.0F};
  Vec3 normal{0.0F, 0.0F, 1.0F};

  explicit OrthonormalFrame(const Vec3& unit_normal) : normal(unit_normal) {
    const float sign = std::copysign(1.0F, normal.z);
    const float a = -1.0F / (sign + normal.z);
    const float b = normal.x * normal.y * a;
    tangent = Vec3(1.0F + sign * normal.x * normal.x * a, sign * b, -sign * normal.x);
    bitangent = Vec3(b, sign + normal.y * normal.y * a, -normal.y);
  }
  [[nodiscard]] Vec3 local_from_scene(const Vec3& v) const {
    return {glm::dot(v, tangent), glm::dot(v, bitangent), glm::dot(v, normal)};
  }
  [[nodiscard]] Vec3 scene_from_local(const Vec3& v) const {
    return tangent * v.x + bitangent * v.y + normal * v.z;
  }
};

// Uniform on the unit disk from the unit square, continuous and area-preserving (Shirley and Chiu
// 1997), so that stratified numbers stay stratified.
struct DiskPoint {
  float x = 0.0F;
  float y = 0.0F;
};

[[nodiscard]] inline DiskPoint disk_from_square(float u, float v) {
  const float a = 2.0F * u - 1.0F;
  const float b = 2.0F * v - 1.0F;
  const bool wide = a * a > b * b;
  const float radius = wide ? a : b;
  if (radius == 0.0F) { return {}; }
  const SinCos angle = sin_cos_octant(kPi / 4.0F * ((wide ? b : a) / radius));
  const float along = radius * angle.cos;
  const float across = radius * angle.sin;
  return {wide ? along : across, wide ? across : along};
}

// Density cos/pi around +z.
[[nodiscard]] inline Vec3 cosine_direction(float u, float v) {
  const DiskPoint disk = disk_from_square(u, v);
  const float z = std::sqrt(std::max(0.0F, 1.0F - disk.x * disk.x - disk.y * disk.y));
  return {disk.x, disk.y, z};
}

}  // namespace preheat
