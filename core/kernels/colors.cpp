// Canonical colours: equalized by tables (panoloc.core.features.equalization), and mixed with local contrast (panoloc.core.features.canonical).

#include "kernels.h"

namespace panoloc {
namespace {

constexpr int LEVELS = 256;

// The level that a colour in 0..1 is nearest to; of two that are as near the even one, as in tensors.
inline int32_t level_of(float color) { return std::min(LEVELS - 1, std::max(0, int32_t(std::rint(color * (LEVELS - 1))))); }

// Levels of colours, many in one loop; between them memory is read and written at places that hang on the colour.
constexpr int64_t AT_ONCE = 1536;

inline void levels_of(const float* colors, int64_t count, int32_t* levels) {
    for (int64_t i = 0; i < count; ++i) levels[i] = level_of(colors[i]);
}

// Smooth small images (3, rows, columns), read line by line at a larger size, bilinear; around the seam where the last column is beside the
// first. Colours against them: the logistic function of logarithms to base 2 is half of 1 + tanh of natural ones.
class Surroundings {
  public:
    Surroundings(int64_t rows, int64_t columns, int64_t height, int64_t width, bool is_round, float darkest, float scale)
        : rows_(rows), columns_(columns), per_row_(float(rows) / height), darkest_(darkest), sharpness_(2 / scale), left_(width),
          right_(width), across_(width), line_(3 * columns) {
        for (int64_t x = 0; x < width; ++x) {
            const float at = (x + 0.5f) * columns / width - 0.5f, from = std::floor(at);
            const auto a = int64_t(from);
            across_[x] = at - from;
            left_[x] = int32_t(is_round ? (a + columns) % columns : std::max<int64_t>(0, a));
            right_[x] = int32_t(is_round ? (a + 1) % columns : std::min(columns - 1, a + 1));
        }
    }

    // Go to a line; means: of natural logarithms.
    void go_to(int64_t y, const float* means) {
        const float at = std::max(0.0f, (y + 0.5f) * per_row_ - 0.5f), down = at - std::floor(at), in_base_2 = 1 / std::log(2.0f);
        const int64_t above = int64_t(at), below = std::min(rows_ - 1, above + 1);
        for (int64_t k = 0; k < 3 * columns_; ++k) {
            const float* plane = means + k / columns_ * rows_ * columns_ + k % columns_;
            line_[k] = (plane[above * columns_] * (1 - down) + plane[below * columns_] * down) * in_base_2;
        }
    }

    // Write the contrast of a channel of the line, each `stride`th of `color`.
    template <int STRIDE> void contrast(int channel, const float* color, float* found) const {
        const int32_t *a = left_.data(), *b = right_.data();
        const float *share = across_.data(), *mean = line_.data() + channel * columns_, darkest = darkest_, sharpness = sharpness_;
        const int64_t width = int64_t(left_.size());
#pragma GCC ivdep
        for (int64_t x = 0; x < width; ++x) {
            const float around = mean[a[x]] + (mean[b[x]] - mean[a[x]]) * share[x];
            found[x] = 1 / (1 + exp2_of(sharpness * (around - log2_of(color[STRIDE * x] + darkest))));
        }
    }

  private:
    const int64_t rows_, columns_;
    const float per_row_, darkest_, sharpness_;
    std::vector<int32_t> left_, right_;
    std::vector<float> across_, line_;
};

}  // namespace
}  // namespace panoloc

// Tables (B, 3, 256) that equalize images (B, P, 3), weights (B, P) of their pixels.
extern "C" void equalization_tables(const float* colors, const float* weights, int64_t images, int64_t pixels, float* tables) {
    using namespace panoloc;
    int32_t levels[AT_ONCE];
    for (int64_t b = 0; b < images; ++b) {
        // Two by turns: neighbours are often of one level, whose sum would have to wait for itself.
        float histogram[2][3][LEVELS] = {};
        for (int64_t first = 0; first < pixels; first += AT_ONCE / 3) {
            const int64_t count = std::min(AT_ONCE / 3, pixels - first);
            const float *color = colors + 3 * (b * pixels + first), *weight = weights + b * pixels + first;
            levels_of(color, 3 * count, levels);
            for (int64_t i = 0; i < count; ++i)
                for (int c = 0; c < 3; ++c) histogram[i & 1][c][levels[3 * i + c]] += weight[i];
        }
        for (int c = 0; c < 3; ++c) {
            float *table = tables + (3 * b + c) * LEVELS, darker = 0;
            for (int level = 0; level < LEVELS; ++level) {
                const float here = histogram[0][c][level] + histogram[1][c][level];
                table[level] = darker + here / 2;
                darker += here;
            }
            for (int level = 0; level < LEVELS; ++level) table[level] /= std::max(darker, 1e-12f);
        }
    }
}

// Look images (B, P, 3) up in tables (B, 3, 256).
extern "C" void apply_tables(const float* colors, const float* tables, int64_t images, int64_t pixels, float* found) {
    using namespace panoloc;
    int32_t levels[AT_ONCE];
    for (int64_t b = 0; b < images; ++b) {
        const float* table = tables + 3 * b * LEVELS;
        for (int64_t first = 3 * b * pixels; first < 3 * (b + 1) * pixels; first += AT_ONCE) {
            const int64_t count = std::min(AT_ONCE, 3 * (b + 1) * pixels - first);
            levels_of(colors + first, count, levels);
            for (int64_t i = 0; i < count; i += 3)
                for (int c = 0; c < 3; ++c) found[first + i + c] = table[c * LEVELS + levels[i + c]];
        }
    }
}

// Write pixels (..., 4) of a window: colours of packed planes (3, packed_height, packed_width), looked up in tables (3, 256), mixed with their
// contrast to the mean logarithm of what is around (3, rows, columns), and validity. first: number of the window's first pixel.
extern "C" void mixed_colors(const float* packed, const float* valid, int64_t packed_height, int64_t packed_width, int64_t first, int64_t height,
    int64_t width, const float* around, int64_t rows, int64_t columns, int64_t is_round, const float* tables, float darkest, float scale,
    float share, float* pixels) {
    using namespace panoloc;
    Surroundings surroundings(rows, columns, height, width, is_round != 0, darkest, scale);
    std::vector<float> mixed(3 * width);
    for (int64_t y = 0; y < height; ++y) {
        surroundings.go_to(y, around);
        const int64_t start = first + y * packed_width;
        for (int c = 0; c < 3; ++c) {
            const float *from = packed + c * packed_height * packed_width + start, *table = tables + c * LEVELS;
            float* to = mixed.data() + c * width;
            surroundings.contrast<1>(c, from, to);
#pragma GCC ivdep
            for (int64_t x = 0; x < width; ++x) {
                const float equalized = table[level_of(from[x])];
                to[x] = equalized + (to[x] - equalized) * share;
            }
        }
        for (int64_t x = 0; x < width; ++x) {
            float* to = pixels + 4 * (start + x);
            to[0] = mixed[x], to[1] = mixed[width + x], to[2] = mixed[2 * width + x], to[3] = valid[start + x];
        }
    }
}

// Write the contrast (B, height, width, 3) of images to the mean logarithm of what is around (B, 3, rows, columns), 0.5 where they are not valid.
extern "C" void local_contrast(const float* colors, const float* valid, int64_t images, int64_t height, int64_t width, const float* around,
    int64_t rows, int64_t columns, int64_t is_round, float darkest, float scale, float* contrast) {
    using namespace panoloc;
    Surroundings surroundings(rows, columns, height, width, is_round != 0, darkest, scale);
    std::vector<float> found(3 * width);
    for (int64_t number = 0; number < images * height; ++number) {
        surroundings.go_to(number % height, around + 3 * rows * columns * (number / height));
        const float* seen = valid + number * width;
        float* to = contrast + 3 * number * width;
        for (int c = 0; c < 3; ++c) surroundings.contrast<3>(c, colors + 3 * number * width + c, found.data() + c * width);
        for (int64_t x = 0; x < width; ++x)
            for (int c = 0; c < 3; ++c) to[3 * x + c] = seen[x] > 0 ? found[c * width + x] : 0.5f;
    }
}

// Colours (P, 3) of an image (height, width, 3) at pixel coordinates u and v (P,), bilinear, where `shown` (P,), else 0; and where all four pixels
// that are mixed are valid (height, width).
extern "C" void sample_image(const uint8_t* color, const uint8_t* valid, int64_t height, int64_t width, const double* u, const double* v,
    const uint8_t* shown, int64_t count, uint8_t* sampled, uint8_t* seen) {
    for (int64_t i = 0; i < count; ++i) {
        std::fill_n(sampled + 3 * i, 3, uint8_t(0));
        seen[i] = 0;
        if (!shown[i]) continue;
        const auto at_u = float(u[i] - 0.5), at_v = float(v[i] - 0.5);
        const int64_t left = std::clamp<int64_t>(int64_t(std::floor(at_u)), 0, std::max<int64_t>(width - 2, 0));
        const int64_t top = std::clamp<int64_t>(int64_t(std::floor(at_v)), 0, std::max<int64_t>(height - 2, 0));
        const int64_t right = std::min(left + 1, width - 1), bottom = std::min(top + 1, height - 1);
        const float across = std::clamp(at_u - float(left), 0.0f, 1.0f), down = std::clamp(at_v - float(top), 0.0f, 1.0f);
        const int64_t corners[4] = {top * width + left, top * width + right, bottom * width + left, bottom * width + right};
        for (int c = 0; c < 3; ++c) {
            const float upper = color[3 * corners[0] + c] * (1 - across) + color[3 * corners[1] + c] * across;
            const float lower = color[3 * corners[2] + c] * (1 - across) + color[3 * corners[3] + c] * across;
            sampled[3 * i + c] = uint8_t(upper * (1 - down) + lower * down + 0.5f);
        }
        seen[i] = valid[corners[0]] && valid[corners[1]] && valid[corners[2]] && valid[corners[3]];
    }
}
