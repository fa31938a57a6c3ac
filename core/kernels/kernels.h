// What the kernels share: elementary functions, pixels of images, and the pool of threads.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <functional>
#include <limits>
#include <vector>

namespace panoloc {

constexpr float PI = 3.14159265358979f;

// atan of 0..1, a polynomial fitted at Chebyshev nodes: off by less than 2e-7 rad.
inline float atan_of_share(float t) {
    const float z = t * t;
    float sum = 0.0028340643f;
    sum = sum * z - 0.0160050305f;
    sum = sum * z + 0.0425876075f;
    sum = sum * z - 0.0749544544f;
    sum = sum * z + 0.1063675410f;
    sum = sum * z - 0.1420257051f;
    sum = sum * z + 0.1999248358f;
    sum = sum * z - 0.3333306678f;
    sum = sum * z + 0.9999999842f;
    return sum * t;
}

// The angle of (x, y) without a branch, so that loops over it become loops over vectors; 0 at the origin.
inline float angle_of(float y, float x) {
    const float across = std::fabs(x), up = std::fabs(y);
    const float longer = std::max(across, up), shorter = std::min(across, up);
    float angle = atan_of_share(shorter / std::max(longer, 1e-30f));
    angle = up > across ? PI / 2 - angle : angle;
    angle = x < 0 ? PI - angle : angle;
    return y < 0 ? -angle : angle;
}

// The number of the pixel of a sphere that shows a direction.
inline int32_t pixel_towards(float x, float y, float z, int32_t rows) {
    const float per_rad = float(rows) / PI, turn = float(2 * rows);
    float u = (PI - angle_of(y, x)) * per_rad;
    const float v = (PI / 2 - angle_of(z, std::sqrt(x * x + y * y))) * per_rad;
    u = u >= turn ? u - turn : u;
    const int32_t column = std::min(2 * rows - 1, std::max(0, int32_t(u))), row = std::min(rows - 1, std::max(0, int32_t(v)));
    return row * 2 * rows + column;
}

// log2 of a positive normal number, a polynomial fitted at Chebyshev nodes: off by less than 1e-5.
inline float log2_of(float value) {
    uint32_t bits;
    std::memcpy(&bits, &value, sizeof bits);
    const float exponent = float(int32_t(bits >> 23) - 127);
    bits = (bits & 0x007fffff) | 0x3f800000;
    std::memcpy(&value, &bits, sizeof bits);
    const float m = value - 1;
    float sum = -0.0345952112f;
    sum = sum * m + 0.1464336147f;
    sum = sum * m - 0.3033896686f;
    sum = sum * m + 0.4693016673f;
    sum = sum * m - 0.7204423705f;
    sum = sum * m + 1.4426832520f;
    return exponent + sum * m;
}

// 2 to the power of a number, likewise: off by less than 4e-6 of it; beyond ±120 it is what it is there.
inline float exp2_of(float value) {
    value = std::min(120.0f, std::max(-120.0f, value));
    const int32_t whole = int32_t(value + 128) - 128;  // rounded down, for what is rounded to zero is positive
    const float f = value - float(whole);
    const uint32_t bits = uint32_t(whole + 127) << 23;
    float power, sum = 0.0136839829f;
    std::memcpy(&power, &bits, sizeof power);
    sum = sum * f + 0.0517177355f;
    sum = sum * f + 0.2416213227f;
    sum = sum * f + 0.6929695509f;
    sum = sum * f + 1.0000035971f;
    return power * sum;
}

using Pixel = float __attribute__((vector_size(16)));  // red, green, blue, validity

constexpr float VALID_SHARE = 0.99f;  // of the four pixels that a sample mixes

inline Pixel pixel_at(const float* from) {
    Pixel found;
    std::memcpy(&found, from, sizeof found);
    return found;
}

// One image level; see panoloc.core.image.level.
struct Level {
    const float *pixels, *places, *rotations, *centers;
    int64_t width;
    int images;
    float per_rad;
};

// Call work(0), work(1), ... work(count - 1), on as many threads as were set; returns when all are done.
void for_each(int64_t count, const std::function<void(int64_t)>& work);

}  // namespace panoloc
