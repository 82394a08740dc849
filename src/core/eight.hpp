// Eight numbers at once: the channels of a pixel, or eight modes. Compilers vectorise short loops badly, so that
// the few loops over eight numbers say it themselves. GCC and Clang map this type to the registers of any processor.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

#if defined(__AVX2__)
#include <immintrin.h>
#endif

namespace liaam {

constexpr std::size_t kEight = 8;

#if defined(__GNUC__) || defined(__clang__)

typedef float Eight __attribute__((vector_size(32)));
typedef float Four __attribute__((vector_size(16)));

#else  // plain, for compilers without this extension

template <std::size_t N>
struct Lanes {
    float lane[N];
    float operator[](std::size_t i) const { return lane[i]; }
    Lanes& operator+=(const Lanes& b) {
        for (std::size_t i = 0; i < N; ++i) lane[i] += b.lane[i];
        return *this;
    }
    friend Lanes operator+(Lanes a, const Lanes& b) { return a += b; }
    friend Lanes operator-(Lanes a, const Lanes& b) {
        for (std::size_t i = 0; i < N; ++i) a.lane[i] -= b.lane[i];
        return a;
    }
    friend Lanes operator*(Lanes a, const Lanes& b) {
        for (std::size_t i = 0; i < N; ++i) a.lane[i] *= b.lane[i];
        return a;
    }
    friend Lanes operator*(float a, Lanes b) {
        for (float& each : b.lane) each *= a;
        return b;
    }
};
using Eight = Lanes<kEight>;
using Four = Lanes<4>;

#endif

inline Four load_four(const float* from) {
    Four four;
    std::memcpy(&four, from, sizeof(four));
    return four;
}

inline void store_four(float* to, Four four) { std::memcpy(to, &four, sizeof(four)); }

inline Eight load(const float* from) {
    Eight eight;
    std::memcpy(&eight, from, sizeof(eight));
    return eight;
}

// Eight integers of 16 bits. GCC 12 makes six instructions of a conversion that AVX2 does in two.
inline Eight load(const std::int16_t* from) {
#if defined(__AVX2__)
    __m128i codes;
    std::memcpy(&codes, from, sizeof(codes));
    return _mm256_cvtepi32_ps(_mm256_cvtepi16_epi32(codes));
#elif defined(__GNUC__) || defined(__clang__)
    typedef std::int16_t Codes __attribute__((vector_size(16)));
    Codes codes;
    std::memcpy(&codes, from, sizeof(codes));
    return __builtin_convertvector(codes, Eight);
#else
    Eight eight;
    for (std::size_t i = 0; i < kEight; ++i) eight.lane[i] = from[i];
    return eight;
#endif
}

inline void store(float* to, Eight eight) { std::memcpy(to, &eight, sizeof(eight)); }

// Asks for the line of the cache at an address, which may lie beyond an array's end.
inline void prefetch(const void* address) {
#if defined(__GNUC__) || defined(__clang__)
    __builtin_prefetch(address);
#else
    static_cast<void>(address);
#endif
}

// The lower halves of two.
inline Eight lower_halves(Eight a, Eight b) {
#if defined(__GNUC__) || defined(__clang__)
    return __builtin_shufflevector(a, b, 0, 1, 2, 3, 8, 9, 10, 11);
#else
    for (std::size_t i = 0; i < kEight / 2; ++i) a.lane[kEight / 2 + i] = b.lane[i];
    return a;
#endif
}

// Writes the first number of each of eight rows, then the second, and so on.
inline void transpose(const float* rows, std::size_t stride, float* out) {
#if defined(__GNUC__) || defined(__clang__)
    Eight a[kEight], b[kEight];
    for (std::size_t i = 0; i < kEight; ++i) a[i] = load(rows + i * stride);
    for (std::size_t i = 0; i < kEight; i += 2) {  // pairs, then fours, then eights
        b[i] = __builtin_shufflevector(a[i], a[i + 1], 0, 8, 1, 9, 4, 12, 5, 13);
        b[i + 1] = __builtin_shufflevector(a[i], a[i + 1], 2, 10, 3, 11, 6, 14, 7, 15);
    }
    for (std::size_t i = 0; i < kEight; i += 4)
        for (std::size_t j = 0; j < 2; ++j) {
            a[i + 2 * j] = __builtin_shufflevector(b[i + j], b[i + 2 + j], 0, 1, 8, 9, 4, 5, 12, 13);
            a[i + 2 * j + 1] = __builtin_shufflevector(b[i + j], b[i + 2 + j], 2, 3, 10, 11, 6, 7, 14, 15);
        }
    for (std::size_t i = 0; i < 4; ++i) {
        store(out + i * kEight, __builtin_shufflevector(a[i], a[i + 4], 0, 1, 2, 3, 8, 9, 10, 11));
        store(out + (i + 4) * kEight, __builtin_shufflevector(a[i], a[i + 4], 4, 5, 6, 7, 12, 13, 14, 15));
    }
#else
    for (std::size_t i = 0; i < kEight; ++i)
        for (std::size_t c = 0; c < kEight; ++c) out[i * kEight + c] = rows[c * stride + i];
#endif
}

inline float sum(Eight a) {
#if defined(__GNUC__) || defined(__clang__)
    const Eight fours = a + __builtin_shufflevector(a, a, 4, 5, 6, 7, 0, 1, 2, 3);
    const Eight twos = fours + __builtin_shufflevector(fours, fours, 2, 3, 0, 1, 6, 7, 4, 5);
    return twos[0] + twos[1];
#else
    return ((a[0] + a[4]) + (a[2] + a[6])) + ((a[1] + a[5]) + (a[3] + a[7]));
#endif
}

// The sums of each of eight.
inline Eight sums_of(const Eight (&rows)[kEight]) {
#if defined(__GNUC__) || defined(__clang__)
    Eight twos[4], fours[2];
    for (std::size_t i = 0; i < 4; ++i)
        twos[i] = __builtin_shufflevector(rows[2 * i], rows[2 * i + 1], 0, 2, 8, 10, 4, 6, 12, 14) +
                  __builtin_shufflevector(rows[2 * i], rows[2 * i + 1], 1, 3, 9, 11, 5, 7, 13, 15);
    for (std::size_t i = 0; i < 2; ++i)
        fours[i] = __builtin_shufflevector(twos[2 * i], twos[2 * i + 1], 0, 2, 8, 10, 4, 6, 12, 14) +
                   __builtin_shufflevector(twos[2 * i], twos[2 * i + 1], 1, 3, 9, 11, 5, 7, 13, 15);
    return __builtin_shufflevector(fours[0], fours[1], 0, 1, 2, 3, 8, 9, 10, 11) +
           __builtin_shufflevector(fours[0], fours[1], 4, 5, 6, 7, 12, 13, 14, 15);
#else
    Eight total{};
    for (std::size_t i = 0; i < kEight; ++i) total.lane[i] = sum(rows[i]);
    return total;
#endif
}

}  // namespace liaam
