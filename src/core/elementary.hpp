// Logarithm and exponential of float32 by one polynomial each, so that loops over pixels are vectorised.
#pragma once

#include <bit>
#include <cstddef>
#include <cstdint>

namespace liaam {

// Natural logarithm of a positive normal number, to 2 units in the last place.
inline float log_of(float x) {
    const std::uint32_t bits = std::bit_cast<std::uint32_t>(x);
    // x = 2^e m with m in [sqrt(1/2), sqrt(2))
    const std::uint32_t shifted = bits - 0x3f3504f3u;
    const float e = static_cast<float>(static_cast<std::int32_t>(shifted) >> 23);
    const float m = std::bit_cast<float>((shifted & 0x007fffffu) + 0x3f3504f3u) - 1.0f;
    float tail = 7.0376836292e-2f;
    tail = tail * m - 1.1514610310e-1f;
    tail = tail * m + 1.1676998740e-1f;
    tail = tail * m - 1.2420140846e-1f;
    tail = tail * m + 1.4249322787e-1f;
    tail = tail * m - 1.6668057665e-1f;
    tail = tail * m + 2.0000714765e-1f;
    tail = tail * m - 2.4999993993e-1f;
    tail = tail * m + 3.3333331174e-1f;
    const float square = m * m;
    float low = tail * m * square + e * -2.12194440e-4f;
    low -= 0.5f * square;
    return m + low + e * 0.693359375f;
}

// Exponential of a number that is limited to -87 to 88, to 2 units in the last place.
inline float exp_of(float x) {
    x = x < 88.0f ? x : 88.0f;
    x = x > -87.0f ? x : -87.0f;  // also for NaN
    const float scaled = x * 1.44269504088896341f;
    const std::int32_t n = static_cast<std::int32_t>(scaled + (scaled < 0.0f ? -0.5f : 0.5f));
    const float whole = static_cast<float>(n);
    const float r = (x - whole * 0.693359375f) + whole * 2.12194440e-4f;
    float series = 1.9875691500e-4f;
    series = series * r + 1.3981999507e-3f;
    series = series * r + 8.3334519073e-3f;
    series = series * r + 4.1665795894e-2f;
    series = series * r + 1.6666665459e-1f;
    series = series * r + 5.0000001201e-1f;
    series = series * r * r + r + 1.0f;
    return series * std::bit_cast<float>(static_cast<std::uint32_t>(n + 127) << 23);
}

// Angle of a vector, from -pi to pi, to 3e-7; 0 for a vector of no length.
inline float angle_of(float x, float y) {
    constexpr float kQuarter = 0.785398163397448f, kHalf = 1.570796326794897f, kWhole = 3.141592653589793f;
    const float wide = x < 0.0f ? -x : x, high = y < 0.0f ? -y : y;
    const float least = wide < high ? wide : high, most = wide < high ? high : wide;
    // The tangent of the angle to the nearest axis, or to the diagonal, is at most tan(pi / 8).
    const bool by_diagonal = least > 0.414213562f * most;
    const float above = by_diagonal ? least - most : least, below = by_diagonal ? least + most : most;
    const float t = above / (below > 1e-30f ? below : 1e-30f);
    const float square = t * t;
    float series = 8.05374449538e-2f;
    series = series * square - 1.38776856032e-1f;
    series = series * square + 1.99777106478e-1f;
    series = series * square - 3.33329491539e-1f;
    float angle = series * square * t + t + (by_diagonal ? kQuarter : 0.0f);
    angle = wide < high ? kHalf - angle : angle;
    angle = x < 0.0f ? kWhole - angle : angle;
    return y < 0.0f ? -angle : angle;
}

// sRGB-encoded values of linear light, which is at least 0; numbers of the source are `stride` apart. Two passes, since
// compilers do not vectorise a choice between a cheap and an expensive number.
inline void srgb_encode(const float* linear, std::size_t stride, std::size_t n, float* out) {
#pragma omp simd
    for (std::size_t i = 0; i < n; ++i) {
        const float own = linear[stride * i];
        out[i] = 1.055f * exp_of(log_of(own > 1e-9f ? own : 1e-9f) * (1.0f / 2.4f)) - 0.055f;
    }
#pragma omp simd
    for (std::size_t i = 0; i < n; ++i) {
        const float own = linear[stride * i];
        out[i] = own <= 0.0031308f ? 12.92f * own : out[i];
    }
}

}  // namespace liaam
