// Views of a scan, z-buffered: what `render_views` of panoloc.core.render.synthetic_view says in tensors, one view after the other. A block of
// points is projected while it lies in the processor, and each point is written where it belongs at once.

#include "kernels.h"

namespace panoloc {
namespace {

constexpr int BLOCK = 64, THINNINGS = 6, MOST_LEVELS = 12;
using Cell = float __attribute__((vector_size(16)));  // sums of red, green and blue, and how many points

// Points in blocks; thinned[k]: every 2^k-th point of each; see `RenderCloud`.
struct Cloud {
    const float *colors, *centers, *radii, *thinned[THINNINGS];
    int64_t blocks, points;
    float spacing;
};

// See `SphereWindow`.
struct Window {
    int64_t rows, first_row, first_column, height, width;
};

// See `RenderingConfig`.
struct Rules {
    float footprint, slack_spacings, slack_share;
    int64_t fill_levels;
};

// Outside of the cones around `axes` nothing need be drawn; without cones everything is.
struct Cones {
    const float *axes, *sines, *cosines;  // of half their angles
    int64_t count;
};

struct Drawn {
    int32_t pixel, cell, number;
    float distance, spacing;
    uint32_t off_center;
};

// Points on their way into a view; all of one thinning.
struct Batch {
    static constexpr int SIZE = 256;
    int count = 0;
    float x[SIZE], y[SIZE], z[SIZE], distance[SIZE];
    int32_t number[SIZE], column[SIZE], row[SIZE], level[SIZE], off_center[SIZE];
};

// Memory of views, kept from one to the next.
class View {
  public:
    void prepare(const Cloud& cloud, const Window& window, const Rules& rules) {
        cloud_ = cloud, window_ = window, rules_ = rules;
        levels_ = std::min(MOST_LEVELS, std::max(1, std::ilogb(window.rows / 8.0) + 1));
        first_of_.assign(1, 0);
        for (int k = 0; k < levels_; ++k) first_of_.push_back(first_of_.back() + (window.height >> k) * (window.width >> k));
    }

    void draw(const float* center, const float* rotation, const Cones& cones) {
        nearest_.assign(first_of_.back(), std::numeric_limits<float>::infinity());
        drawn_.clear();
        choose_blocks(center, cones);
        for (int thinning = 0; thinning < THINNINGS; ++thinning) {
            const int count = BLOCK >> thinning;
            for (int64_t block = 0; block < cloud_.blocks; ++block) {
                if (thinning_[block] != thinning) continue;
                if (batch_.count + count > Batch::SIZE) draw_batch(thinning, center, rotation);
                const float* from = cloud_.thinned[thinning] + 3 * count * block;
                std::copy_n(from, count, batch_.x + batch_.count);
                std::copy_n(from + count, count, batch_.y + batch_.count);
                std::copy_n(from + 2 * count, count, batch_.z + batch_.count);
                for (int i = 0; i < count; ++i) batch_.number[batch_.count + i] = int32_t(BLOCK * block + (i << thinning));
                batch_.count += count;
            }
            draw_batch(thinning, center, rotation);
        }
    }

    // The smallest depth over all levels.
    void depth(float* depth) {
        for (int k = levels_ - 2; k >= 0; --k)
            for_cells(k, [&](int64_t cell, int64_t above) { nearest_[cell] = std::min(nearest_[cell], nearest_[above]); });
        std::copy_n(nearest_.data(), first_of_[1], depth);
    }

    // The colour of the finest level with a visible point; points: the one nearest to the middle of each pixel, −1 without any.
    void colors(const float* depth, float* color, uint8_t* valid, int64_t* points) {
        sums_.assign(first_of_.back(), Cell{});
        if (points) best_.assign(first_of_[1], std::numeric_limits<uint64_t>::max());
        for (const Drawn& point : drawn_) {
            const float behind = rules_.slack_spacings * point.spacing + depth[point.pixel] * (1 + rules_.slack_share);
            if (point.distance > behind) continue;
            Cell shown;
            std::memcpy(&shown, cloud_.colors + 4 * int64_t(point.number), sizeof shown);
            sums_[point.cell] += shown;
            // What fills up the last block lies where its last point does.
            const uint64_t number = std::min<int64_t>(point.number, cloud_.points - 1);
            if (points) best_[point.pixel] = std::min(best_[point.pixel], uint64_t(point.off_center) << 32 | number);
        }
        fill();
        for (int64_t i = 0; i < first_of_[1]; ++i) {
            for (int c = 0; c < 3; ++c) color[3 * i + c] = filled_[i][c];
            valid[i] = filled_[i][3] > 0;
            if (points) points[i] = best_[i] == std::numeric_limits<uint64_t>::max() ? -1 : int64_t(best_[i] & 0xffffffff);
        }
    }

  private:
    // A block is thinned by the largest power of two that leaves a point in every pixel; −1: it is not drawn.
    void choose_blocks(const float* center, const Cones& cones) {
        const int64_t n = cloud_.blocks;
        thinning_.resize(n);
        const float per_metre = PI / window_.rows / (rules_.footprint * cloud_.spacing), *centers = cloud_.centers, *radii = cloud_.radii;
        const float ox = center[0], oy = center[1], oz = center[2];
        int32_t* found = thinning_.data();
#pragma GCC ivdep
        for (int64_t block = 0; block < n; ++block) {
            const float x = centers[3 * block] - ox, y = centers[3 * block + 1] - oy, z = centers[3 * block + 2] - oz;
            const float points = (std::sqrt(x * x + y * y + z * z) - radii[block]) * per_metre;
            const float in_pixel = points > 1 ? points * points : 1;
            int32_t thinning = 0;
            for (int k = 1; k < THINNINGS; ++k) thinning += in_pixel >= float(1 << k);
            found[block] = thinning;
        }
        if (cones.count == 0) return;
        for (int64_t block = 0; block < n; ++block) {
            const float towards[3] = {centers[3 * block] - ox, centers[3 * block + 1] - oy, centers[3 * block + 2] - oz};
            const float distance = std::sqrt(towards[0] * towards[0] + towards[1] * towards[1] + towards[2] * towards[2]);
            bool is_within = distance <= radii[block];
            const float reach_sine = std::min(1.0f, radii[block] / std::max(distance, 1e-6f));
            const float reach_cosine = std::sqrt(1 - reach_sine * reach_sine);
            for (int64_t m = 0; m < cones.count && !is_within; ++m) {
                const float *axis = cones.axes + 3 * m, along = towards[0] * axis[0] + towards[1] * axis[1] + towards[2] * axis[2];
                // Half the cone's angle and the block's own together, which may be more than a half turn.
                const float sine = cones.sines[m] * reach_cosine + cones.cosines[m] * reach_sine;
                is_within = sine <= 0 || along >= distance * (cones.cosines[m] * reach_cosine - cones.sines[m] * reach_sine);
            }
            if (!is_within) found[block] = -1;
        }
    }

    void draw_batch(int thinning, const float* center, const float* rotation) {
        float r[9], o[3];
        std::copy_n(rotation, 9, r), std::copy_n(center, 3, o);
        const float per_rad = window_.rows / PI, turn = 2.0f * window_.rows, spacing = cloud_.spacing * std::sqrt(float(1 << thinning));
        // A footprint of exactly one pixel belongs to the finest level in spite of rounding.
        const float per_metre = 0.999f * rules_.footprint * per_rad * spacing;
        const int32_t last_row = int32_t(window_.rows) - 1, last_column = 2 * last_row + 1;
        const int32_t first_row = int32_t(window_.first_row), first_column = int32_t(window_.first_column), coarsest = levels_ - 1;
        Batch& batch = batch_;
#pragma GCC ivdep
        for (int i = 0; i < batch.count; ++i) {
            const float dx = batch.x[i] - o[0], dy = batch.y[i] - o[1], dz = batch.z[i] - o[2];
            const float ahead = r[0] * dx + r[3] * dy + r[6] * dz, left = r[1] * dx + r[4] * dy + r[7] * dz;
            const float up = r[2] * dx + r[5] * dy + r[8] * dz, flat_square = ahead * ahead + left * left;
            const float distance = std::sqrt(flat_square + up * up);
            float u = (PI - angle_of(left, ahead)) * per_rad;
            const float v = (PI / 2 - angle_of(up, std::sqrt(flat_square))) * per_rad;
            u = u >= turn ? u - turn : u;
            const int32_t column = int32_t(u), row = int32_t(v);
            const float beside = u - float(column) - 0.5f, below = v - float(row) - 0.5f;
            const float footprint = per_metre / (distance > 1e-6f ? distance : 1e-6f);
            int32_t level = 0;
            for (int k = 0; k < MOST_LEVELS; ++k) level += footprint > float(1 << k);
            batch.level[i] = level < coarsest ? level : coarsest;
            batch.off_center[i] = int32_t((beside * beside + below * below) * float(1 << 20));
            batch.column[i] = (column < last_column ? column : last_column) - first_column;
            batch.row[i] = (row < last_row ? row : last_row) - first_row;
            batch.distance[i] = distance;
        }
        const auto height = int32_t(window_.height), width = int32_t(window_.width);
        for (int i = 0; i < batch.count; ++i) {
            const int32_t row = batch.row[i], column = batch.column[i], level = batch.level[i];
            if (column < 0 || column >= width || row < 0 || row >= height) continue;
            const int32_t cell_row = std::min(row >> level, (height >> level) - 1), cell_column = std::min(column >> level, (width >> level) - 1);
            const int32_t cell = int32_t(first_of_[level]) + cell_row * (width >> level) + cell_column;
            nearest_[cell] = std::min(nearest_[cell], batch.distance[i]);
            drawn_.push_back({row * width + column, cell, batch.number[i], batch.distance[i], spacing, uint32_t(batch.off_center[i])});
        }
        batch.count = 0;
    }

    // A cell also counts the points written up to `fill_levels` levels below it, so that gaps of a few pixels are filled while windows and
    // unscanned corners stay missing.
    void fill() {
        filled_ = sums_;
        pooled_ = sums_;  // of each level, what the level `halvings` below it has
        for (int64_t halvings = 1; halvings <= rules_.fill_levels; ++halvings)
            for (int k = levels_ - 1; k >= halvings; --k) {
                std::fill(pooled_.begin() + first_of_[k], pooled_.begin() + first_of_[k + 1], Cell{});
                for_cells(k - 1, [&](int64_t cell, int64_t above) { pooled_[above] += pooled_[cell]; });
                for (int64_t cell = first_of_[k]; cell < first_of_[k + 1]; ++cell) filled_[cell] += pooled_[cell];
            }
        for (Cell& cell : filled_) {
            const float count = cell[3];
            cell /= std::max(count, 1.0f);
            cell[3] = count > 0;
        }
        for (int k = levels_ - 2; k >= 0; --k)
            for_cells(k, [&](int64_t cell, int64_t above) { if (filled_[cell][3] <= 0) filled_[cell] = filled_[above]; });
    }

    // Call work(cell, the cell above it) for all cells of a level.
    template <typename Work> void for_cells(int level, const Work& work) {
        const int64_t height = window_.height >> level, width = window_.width >> level;
        for (int64_t row = 0; row < height; ++row)
            for (int64_t column = 0; column < width; ++column)
                work(first_of_[level] + row * width + column, first_of_[level + 1] + (row / 2) * (width / 2) + column / 2);
    }

    Cloud cloud_;
    Window window_;
    Rules rules_;
    int levels_ = 0;
    std::vector<int64_t> first_of_;
    std::vector<int32_t> thinning_;
    Batch batch_;
    std::vector<float> nearest_;
    std::vector<Cell> sums_, pooled_, filled_;
    std::vector<Drawn> drawn_;
    std::vector<uint64_t> best_;
};

// Not inlined, so that a thread looks up only once where its memory is.
__attribute__((noinline)) View& view_of_thread() {
    thread_local View view;
    return view;
}

}  // namespace
}  // namespace panoloc

// Shapes: as of `RenderCloud`, `ViewParts` and `SyntheticViews`; point, or color, valid and point, are left out where they are null.
extern "C" void render_views(const float* colors, const float* block_centers, const float* block_radii, const float* every, const float* every_2nd,
    const float* every_4th, const float* every_8th, const float* every_16th, const float* every_32nd, int64_t blocks, int64_t points, float spacing,
    int64_t rows, int64_t first_row, int64_t first_column, int64_t height, int64_t width, float footprint, float slack_spacings,
    float slack_share, int64_t fill_levels, int64_t views, const float* centers, const float* rotations, const float* axes,
    const float* half_angles, int64_t cones, float* color, float* depth, uint8_t* valid, int64_t* point) {
    using namespace panoloc;
    const Cloud cloud{colors, block_centers, block_radii, {every, every_2nd, every_4th, every_8th, every_16th, every_32nd}, blocks, points, spacing};
    const Window window{rows, first_row, first_column, height, width};
    const Rules rules{footprint, slack_spacings, slack_share, fill_levels};
    const int64_t pixels = height * width;
    std::vector<float> sines(cones), cosines(cones);
    for (int64_t m = 0; m < cones; ++m) sines[m] = std::sin(half_angles[m]), cosines[m] = std::cos(half_angles[m]);
    for_each(views, [&](int64_t b) {
        View& view = view_of_thread();
        view.prepare(cloud, window, rules);
        view.draw(centers + 3 * b, rotations + 9 * b, {axes + 3 * b * cones, sines.data(), cosines.data(), cones});
        view.depth(depth + b * pixels);
        if (color) view.colors(depth + b * pixels, color + 3 * b * pixels, valid + b * pixels, point ? point + b * pixels : nullptr);
    });
}
