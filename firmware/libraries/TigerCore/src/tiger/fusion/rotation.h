// Vectors and unit quaternions, as small as the attitude filter needs them.
//
// A quaternion q turns a vector v from the frame it is named after into the other: rotate(body_to_earth, v_body).
// The operations are built on one another, not unrolled: on the AVR a float operation is a call, and flash is what
// runs out first.
#pragma once

#include <math.h>
#include <stdint.h>

// A function that is never worth a copy at each place of use, and whose stack frame shall end with it.
#ifdef __AVR__
#define TIGER_OUTLINE __attribute__((noinline))
#else
#define TIGER_OUTLINE
#endif

namespace tiger {
namespace fusion {

constexpr float kGravityMps2 = 9.80665f;

struct Vec3 {
  float x, y, z;
};

struct Quat {
  float w;
  Vec3 v;
};

TIGER_OUTLINE inline Vec3 operator+(const Vec3& a, const Vec3& b) {
  return Vec3{a.x + b.x, a.y + b.y, a.z + b.z};
}
TIGER_OUTLINE inline Vec3 operator-(const Vec3& a, const Vec3& b) {
  return Vec3{a.x - b.x, a.y - b.y, a.z - b.z};
}
TIGER_OUTLINE inline Vec3 operator*(float s, const Vec3& a) { return Vec3{s * a.x, s * a.y, s * a.z}; }
TIGER_OUTLINE inline float dot(const Vec3& a, const Vec3& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
TIGER_OUTLINE inline Vec3 cross(const Vec3& a, const Vec3& b) {
  return Vec3{a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

TIGER_OUTLINE inline float clamp(float value, float limit) {
  return value > limit ? limit : (value < -limit ? -limit : value);
}

constexpr Quat identity() { return Quat{1.0f, {0.0f, 0.0f, 0.0f}}; }
inline Quat conjugate(const Quat& q) { return Quat{q.w, {-q.v.x, -q.v.y, -q.v.z}}; }
inline float norm2(const Quat& q) { return q.w * q.w + dot(q.v, q.v); }

TIGER_OUTLINE inline Quat scaled(float s, const Quat& q) { return Quat{s * q.w, s * q.v}; }

TIGER_OUTLINE inline Quat operator*(const Quat& a, const Quat& b) {
  const Vec3 c = cross(a.v, b.v);
  return Quat{
      a.w * b.w - dot(a.v, b.v),
      {a.w * b.v.x + b.w * a.v.x + c.x, a.w * b.v.y + b.w * a.v.y + c.y, a.w * b.v.z + b.w * a.v.z + c.z}};
}

// a turned by q: a + 2 w (v x a) + 2 v x (v x a).
TIGER_OUTLINE inline Vec3 rotate(const Quat& q, const Vec3& a) {
  const Vec3 half = cross(q.v, a);
  const Vec3 t = half + half;
  return a + q.w * t + cross(q.v, t);
}

// The matrix that does what rotate(q, .) does, as its three rows.
struct Mat3 {
  Vec3 row[3];
};

TIGER_OUTLINE inline Mat3 matrix(const Quat& q) {
  const Quat back = conjugate(q);
  const Vec3 x = rotate(back, Vec3{1.0f, 0.0f, 0.0f});
  const Vec3 y = rotate(back, Vec3{0.0f, 1.0f, 0.0f});
  return Mat3{{x, y, cross(x, y)}};
}

inline Vec3 operator*(const Mat3& m, const Vec3& v) {
  return Vec3{dot(m.row[0], v), dot(m.row[1], v), dot(m.row[2], v)};
}

// One Newton step towards |q| = 1: exact to second order, for a quaternion that is nearly of unit length.
TIGER_OUTLINE inline Quat renormalised(const Quat& q) { return scaled(1.5f - 0.5f * norm2(q), q); }

// Any quaternion to unit length; the identity when it has none.
TIGER_OUTLINE inline Quat normalised(const Quat& q) {
  const float n2 = norm2(q);
  return n2 > 1e-12f ? scaled(1.0f / sqrtf(n2), q) : identity();
}

// exp(angle / 2) for a turn smaller than 1 rad: Taylor series, error below 2e-6 rad at 0.5 rad, at a tenth of the
// cycles of sinf and cosf.
TIGER_OUTLINE inline Quat small_turn(const Vec3& angle) {
  const Vec3 h = 0.5f * angle;
  const float s2 = dot(h, h);
  const float sinc = 1.0f - s2 * (1.0f / 6.0f) * (1.0f - s2 * (1.0f / 20.0f));
  const float cosine = 1.0f - s2 * 0.5f * (1.0f - s2 * (1.0f / 12.0f));
  return Quat{cosine, sinc * h};
}

// Angle brought into (-pi, pi].
inline float wrapped(float angle) {
  constexpr float kPi = 3.14159265f;
  while (angle > kPi) angle -= 2.0f * kPi;
  while (angle <= -kPi) angle += 2.0f * kPi;
  return angle;
}

}  // namespace fusion
}  // namespace tiger
