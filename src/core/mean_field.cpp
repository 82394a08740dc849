#include "mean_field.hpp"

#include "elementary.hpp"

namespace liaam {

namespace {

constexpr float kLeastShare = 1e-6f;  // of a neighbourhood without sampled pixels

// Blurs planes by the taps; pixels beyond the border are 0.
class Blur {
  public:
    Blur(std::ptrdiff_t height, std::ptrdiff_t width, Floats taps)
        : height_(height), width_(width), reach_(static_cast<std::ptrdiff_t>(taps.size()) - 1), taps_(taps),
          padded_((height + 2 * reach_) * width), line_(width + 2 * reach_) {}

    // Where a plane is written that is to be blurred.
    float* plane() { return padded_.data() + reach_ * width_; }

    void write(float* out) {
        for (std::ptrdiff_t y = 0; y < height_; ++y, out += width_) {
            add_along(plane() + y * width_, width_, line_.data() + reach_);
            add_along(line_.data() + reach_, 1, out);
        }
    }

  private:
    // The sum of numbers that are `step` apart, for each number of a row.
    void add_along(const float* from, std::ptrdiff_t step, float* sums) const {
        const float middle = taps_[0];
#pragma omp simd
        for (std::ptrdiff_t x = 0; x < width_; ++x) sums[x] = middle * from[x];
        for (std::ptrdiff_t k = 1; k <= reach_; ++k) {
            const float *before = from - k * step, *after = from + k * step;
            const float tap = taps_[k];
#pragma omp simd
            for (std::ptrdiff_t x = 0; x < width_; ++x) sums[x] += tap * (before[x] + after[x]);
        }
    }

    std::ptrdiff_t height_, width_, reach_;
    Floats taps_;
    std::vector<float> padded_, line_;
};

}  // namespace

MeanField mean_field(Floats own, Floats sampled, std::ptrdiff_t width, Floats taps, float strength, int rounds) {
    const auto n = static_cast<std::ptrdiff_t>(own.size());
    MeanField field{std::vector<float>(own.begin(), own.end()), std::vector<float>(n)};
    std::vector<float>& labels = field.labels;
    std::vector<float> shares(n);
    Blur blur(n / width, width, taps);
    std::copy(sampled.begin(), sampled.end(), blur.plane());
    blur.write(shares.data());
    const auto set_around = [&] {
#pragma omp simd
        for (std::ptrdiff_t i = 0; i < n; ++i) blur.plane()[i] = labels[i] * sampled[i];
        blur.write(field.around.data());
#pragma omp simd
        for (std::ptrdiff_t i = 0; i < n; ++i) field.around[i] /= shares[i] + kLeastShare;
    };
    const auto update = [&](float of_own, float of_others) {  // the hyperbolic tangent of half the log odds
#pragma omp simd
        for (std::ptrdiff_t i = 0; i < n; ++i)
            labels[i] = 1.0f - 2.0f / (1.0f + exp_of(of_own * own[i] + of_others * field.around[i]));
    };
    set_around();
    update(0.0f, 1.0f);
    for (int round = 0; round < rounds; ++round) {
        set_around();
        update(1.0f, strength);
    }
    set_around();
    return field;
}

}  // namespace liaam
