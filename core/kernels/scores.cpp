// Scores of poses by what is inside of squares of pixels: what panoloc.core.search.pixel_scores and position_sweep say in tensors.
// And which of many poses are different ones.

#include <type_traits>

#include "kernels.h"

namespace panoloc {
namespace {

constexpr int LANES = 16;  // starts that are scored together
constexpr float NEAREST_M = 0.1f;
using Lanes = float __attribute__((vector_size(4 * LANES)));

// Chosen without a branch, so that loops become loops over vectors.
inline float larger(float a, float b) { return a > b ? a : b; }

// How much of the contrast inside a square the other side explains, 0..1.
inline float explained(float common, float power) {
    const float correlation = larger(common, 0) / std::sqrt(power), unexplained = 1 - correlation * correlation;
    return 1 - std::sqrt(larger(unexplained, 0));
}

// S pixels of photos, square by square; see `RigPixels`.
struct Photos {
    const float *directions, *centers, *colors, *solid;
    const int64_t* squares;
    int64_t size;
    float total;
};

// Pictures of what starts see, all of `rows` rows.
struct Pictures {
    const uint8_t *colors, *seen;
    const float* depth;
    int32_t rows;
    int64_t pixels() const { return 2 * int64_t(rows) * rows; }
};

class PixelScore {
  public:
    PixelScore(const Photos& photos, const Pictures& pictures, float noise, bool is_labels)
        : photos_(photos), pictures_(pictures), noise_(noise), is_labels_(is_labels), at_(photos.size), weights_(photos.size),
          colors_(3 * photos.size), directions_(in_planes(photos.directions, photos.size)),
          centers_(in_planes(photos.centers, photos.size)), own_(in_planes(photos.colors, photos.size)) {}

    // offset: metres from the start, or null for the start itself.
    float operator()(int64_t start, const float* rotation, const float* offset) {
        if (offset) look_up<true>(rotation, offset, pictures_.depth + start * pictures_.pixels());
        else look_up<false>(rotation, offset, nullptr);
        const uint8_t *colors = pictures_.colors + 3 * start * pictures_.pixels(), *seen = pictures_.seen + start * pictures_.pixels();
        float mass = 0, score = 0;
        for (int64_t s = 0; s < photos_.size; ++s) weights_[s] = seen[at_[s]] ? photos_.solid[s] : 0;
        for (int64_t s = 0; s < photos_.size; ++s) mass += weights_[s];
        equalize(colors);
        for (int64_t s = 0; s < photos_.size; ++s)
            for (int c = 0; c < 3; ++c) colors_[c * photos_.size + s] = tables_[colors[3 * at_[s] + c]][c];
        for (int64_t first = 0, end; first < photos_.size; first = end) {
            for (end = first + 1; end < photos_.size && photos_.squares[end] == photos_.squares[first];) ++end;
            score += score_of_square(first, end);
        }
        // What has changed says nothing, and least of all against a pose; of a pose that sees little of the scan little is known.
        return score / std::max(mass, 1e-9f) * std::sqrt(mass / photos_.total);
    }

  private:
    using Table = float __attribute__((vector_size(16)));

    // Which pixels the photos' directions show. From beside a start, what lies in a direction is looked for along the ray from there: where
    // the view has what it has in that direction, and once more where it has what it has there.
    template <bool BESIDE> void look_up(const float* rotation, const float* offset, const float* depth) {
        float r[9], o[3] = {};
        std::copy_n(rotation, 9, r);
        if (BESIDE) std::copy_n(offset, 3, o);
        const int64_t n = photos_.size;
        const float *dx = directions_.data(), *dy = dx + n, *dz = dy + n, *px = centers_.data(), *py = px + n, *pz = py + n;
        int32_t* at = at_.data();
        const int32_t rows = pictures_.rows;
#pragma GCC ivdep
        for (int64_t s = 0; s < n; ++s) {
            const float tx = r[0] * dx[s] + r[1] * dy[s] + r[2] * dz[s];
            const float ty = r[3] * dx[s] + r[4] * dy[s] + r[5] * dz[s];
            const float tz = r[6] * dx[s] + r[7] * dy[s] + r[8] * dz[s];
            int32_t pixel = pixel_towards(tx, ty, tz, rows);
            if constexpr (BESIDE) {
                const float cx = o[0] + r[0] * px[s] + r[1] * py[s] + r[2] * pz[s];
                const float cy = o[1] + r[3] * px[s] + r[4] * py[s] + r[5] * pz[s];
                const float cz = o[2] + r[6] * px[s] + r[7] * py[s] + r[8] * pz[s];
                const float there = depth[pixel];
                const float x = cx + there * tx, y = cy + there * ty, z = cz + there * tz;
                const float length = depth[pixel_towards(x, y, z, rows)];
                // The place on the ray that is nearest to the point there.
                const float distance = std::max(std::sqrt(x * x + y * y + z * z), 1e-6f);
                const float nearest = (x * tx + y * ty + z * tz) * length / distance - (cx * tx + cy * ty + cz * tz);
                const float along = std::max(nearest, NEAREST_M);
                pixel = pixel_towards(cx + along * tx, cy + along * ty, cz + along * tz, rows);
            }
            at[s] = pixel;
        }
    }

    // Vectors (S, 3) as planes (3, S).
    static std::vector<float> in_planes(const float* vectors, int64_t size) {
        std::vector<float> planes(3 * size);
        for (int64_t s = 0; s < 3 * size; ++s) planes[s % 3 * size + s / 3] = vectors[s];
        return planes;
    }

    // How much of a square the photos explain, times what it weighs.
    float score_of_square(int64_t first, int64_t end) const {
        const float* weight = weights_.data();
        float mass = 0, common = 0, power = 0, own_power = 0, mean[3] = {}, own_mean[3] = {};
        for (int64_t s = first; s < end; ++s) mass += weight[s];
        const float per = 1 / std::max(mass, 1e-9f);
        for (int c = 0; c < 3; ++c) {
            const float *color = colors_.data() + c * photos_.size, *own = own_.data() + c * photos_.size;
            for (int64_t s = first; s < end; ++s) {
                mean[c] += weight[s] * color[s], own_mean[c] += weight[s] * own[s], common += weight[s] * color[s] * own[s];
                power += weight[s] * color[s] * color[s], own_power += weight[s] * own[s] * own[s];
            }
        }
        common *= per, power *= per, own_power *= per;
        for (int c = 0; c < 3; ++c) {
            mean[c] *= per, own_mean[c] *= per;
            common -= mean[c] * own_mean[c], power -= mean[c] * mean[c], own_power -= own_mean[c] * own_mean[c];
        }
        return mass * explained(common, (std::max(power, 0.0f) + noise_) * (std::max(own_power, 0.0f) + noise_));
    }

    // The tables that equalize what is seen; see panoloc.core.features.equalization.
    void equalize(const uint8_t* colors) {
        if (is_labels_) {
            for (int level = 0; level < 256; ++level) tables_[level] = Table{} + float(level) / 255;
            return;
        }
        std::fill_n(tables_, 256, Table{});
        for (int64_t s = 0; s < photos_.size; ++s)
            for (int c = 0; c < 3; ++c) tables_[colors[3 * at_[s] + c]][c] += weights_[s];
        Table darker = {};
        for (Table& table : tables_) {
            const Table here = table;
            table = darker + here / 2;
            darker += here;
        }
        for (int c = 0; c < 3; ++c) darker[c] = 1 / std::max(darker[c], 1e-12f);
        for (Table& table : tables_) table *= darker;
    }

    const Photos& photos_;
    const Pictures& pictures_;
    const float noise_;
    const bool is_labels_;
    std::vector<int32_t> at_;
    std::vector<float> weights_, colors_, directions_, centers_, own_;
    Table tables_[256];
};

// What some starts show, pixel by pixel, with the starts last: red, green, blue, the sum of their squares, and whether it was seen, all zero
// where it was not.
struct Planes {
    static constexpr int COUNT = 5;
    std::vector<float> values;
    bool all_seen = true;  // of starts that there are; those that fill up the lanes do not count

    Planes(const Pictures& pictures, const float* tables, int64_t first, int64_t count) : values(pictures.pixels() * COUNT * LANES) {
        for (int64_t pixel = 0; pixel < pictures.pixels(); ++pixel)
            for (int64_t k = 0; k < count; ++k) {
                const int64_t from = (first + k) * pictures.pixels() + pixel;
                all_seen &= pictures.seen[from] != 0;
                if (!pictures.seen[from]) continue;
                float *to = values.data() + pixel * COUNT * LANES + k, square = 0;
                for (int c = 0; c < 3; ++c) {
                    const float color = tables[256 * c + pictures.colors[3 * from + c]];
                    to[c * LANES] = color, square += color * color;
                }
                to[3 * LANES] = square, to[4 * LANES] = 1;
            }
    }
};

// Score starts with one rotation, under which the photos' pixels lie at `at`; pixels lie square by square. Where the starts show something
// everywhere, sums over the photos alone are the same for all of them.
template <bool ALL_SEEN> void score_starts(const Photos& photos, const Planes& planes, const int32_t* at, float noise, float* scores) {
    using Own = std::conditional_t<ALL_SEEN, float, Lanes>;
    float total[LANES] = {}, score[LANES] = {};
    for (int64_t s = 0; s < photos.size;) {
        Own mass_of = {}, own_squares = {}, owns[3] = {};
        Lanes commons = {}, squares = {}, colors[3] = {};
        const int64_t square = photos.squares[s];
        for (; s < photos.size && photos.squares[s] == square; ++s) {
            const float weight = photos.solid[s], *own = photos.colors + 3 * s;
            Lanes each[ALL_SEEN ? 4 : Planes::COUNT];
            std::memcpy(each, planes.values.data() + int64_t(at[s]) * Planes::COUNT * LANES, sizeof each);
            Own is_seen;
            if constexpr (ALL_SEEN) is_seen = 1;
            else is_seen = each[4];
            mass_of += weight * is_seen, own_squares += weight * (own[0] * own[0] + own[1] * own[1] + own[2] * own[2]) * is_seen;
            squares += weight * each[3];
            for (int c = 0; c < 3; ++c) {
                colors[c] += weight * each[c], owns[c] += weight * own[c] * is_seen;
                commons += weight * own[c] * each[c];
            }
        }
        const Lanes masses = Lanes{} + mass_of, own_square_sums = Lanes{} + own_squares;
        const Lanes own_sums[3] = {Lanes{} + owns[0], Lanes{} + owns[1], Lanes{} + owns[2]};
        for (int k = 0; k < LANES; ++k) {
            const float mass = masses[k], per = 1 / larger(mass, 1e-9f);
            float common = commons[k] * per, power = squares[k] * per, own_power = own_square_sums[k] * per;
            for (int c = 0; c < 3; ++c) {
                const float color = colors[c][k] * per, own = own_sums[c][k] * per;
                common -= color * own, power -= color * color, own_power -= own * own;
            }
            score[k] += mass * explained(common, (larger(power, 0) + noise) * (larger(own_power, 0) + noise));
            total[k] += mass;
        }
    }
    for (int k = 0; k < LANES; ++k) scores[k] = score[k] / std::max(total[k], 1e-9f) * std::sqrt(total[k] / photos.total);
}

}  // namespace
}  // namespace panoloc

// colors (T, P, 3) and seen (T, P) of pictures, depth (T, P) in metres; photos: as of `RigPixels`, `own` their equalized colours, `total` the sum
// of their solid angles. Poses (K,): starts, rotations (K, 3, 3), and offsets (K, 3) from the starts; without offsets depth is not used either.
extern "C" void pixel_scores(const uint8_t* colors, const uint8_t* seen, const float* depth, int64_t rows, const float* directions,
    const float* centers, const float* own, const float* solid, const int64_t* squares, int64_t size, float total,
    float noise, int64_t is_labels, int64_t poses, const int64_t* starts, const float* rotations, const float* offsets,
    float* scores) {
    using namespace panoloc;
    const Photos photos{directions, centers, own, solid, squares, size, total};
    const Pictures pictures{colors, seen, depth, int32_t(rows)};
    constexpr int64_t AT_ONCE = 64;
    const int64_t shares = (poses + AT_ONCE - 1) / AT_ONCE;
    for_each(shares, [&](int64_t share) {
        PixelScore score(photos, pictures, noise, is_labels != 0);
        for (int64_t k = share * AT_ONCE; k < std::min(poses, (share + 1) * AT_ONCE); ++k)
            scores[k] = score(starts[k], rotations + 9 * k, offsets ? offsets + 3 * k : nullptr);
    });
}

// Likewise, of all T starts with R rotations, scores (T, R); tables (3, 256) equalize all pictures.
extern "C" void scores_of_every_pose(const uint8_t* colors, const uint8_t* seen, const float* tables, int64_t rows, int64_t starts,
    const float* directions, const float* own, const float* solid, const int64_t* squares, int64_t size, float total, float noise,
    const float* rotations, int64_t num_rotations, float* scores) {
    using namespace panoloc;
    const Photos photos{directions, nullptr, own, solid, squares, size, total};
    const Pictures pictures{colors, seen, nullptr, int32_t(rows)};
    std::vector<int32_t> at(num_rotations * size);
    for (int64_t k = 0; k < num_rotations; ++k) {
        const float *r = rotations + 9 * k, *d = directions;
        int32_t* found = at.data() + k * size;
#pragma GCC ivdep
        for (int64_t s = 0; s < size; ++s)
            found[s] = pixel_towards(r[0] * d[3 * s] + r[1] * d[3 * s + 1] + r[2] * d[3 * s + 2],
                r[3] * d[3 * s] + r[4] * d[3 * s + 1] + r[5] * d[3 * s + 2],
                r[6] * d[3 * s] + r[7] * d[3 * s + 1] + r[8] * d[3 * s + 2], pictures.rows);
    }
    for_each((starts + LANES - 1) / LANES, [&](int64_t part) {
        const int64_t first = part * LANES, count = std::min<int64_t>(LANES, starts - first);
        const Planes planes(pictures, tables, first, count);
        for (int64_t k = 0; k < num_rotations; ++k) {
            float some[LANES];
            (planes.all_seen ? score_starts<true> : score_starts<false>)(photos, planes, at.data() + k * size, noise, some);
            for (int64_t t = 0; t < count; ++t) scores[(first + t) * num_rotations + k] = some[t];
        }
    });
}

// Scores (R, T) of T views with R rotations: sums over Q patches of similarities (Q P, T), of the one that each lies on, `met` (R, Q), a row.
extern "C" void sums_of_patches(const float* similarities, int64_t rows, int64_t views, const int64_t* met, int64_t rotations, int64_t count,
    float* scores) {
    using namespace panoloc;
    for_each((views + LANES - 1) / LANES, [&](int64_t part) {
        const int64_t first = part * LANES, size = std::min<int64_t>(LANES, views - first);
        std::vector<float> some(rows * LANES);  // what is read again and again for some views stays near the processor
        for (int64_t row = 0; row < rows; ++row) std::copy_n(similarities + row * views + first, size, some.data() + row * LANES);
        for (int64_t r = 0; r < rotations; ++r) {
            Lanes sum = {}, each;
            for (int64_t q = 0; q < count; ++q) {
                std::memcpy(&each, some.data() + met[r * count + q] * LANES, sizeof each);
                sum += each;
            }
            float found[LANES];
            std::memcpy(found, &sum, sizeof found);
            std::copy_n(found, size, scores + r * views + first);
        }
    });
}

// Sums (K,) over Q patches of products of their descriptors (Q, size), weighted, with those that poses put on them: of views (T, patches, size),
// the patches `met` (R, Q) under each rotation. Poses: starts and rotations (K,).
extern "C" void products_of_patches(const float* descriptors, int64_t count, int64_t size, const int8_t* views, int64_t patches, const int64_t* met,
    int64_t poses, const int64_t* starts, const int64_t* rotations, float* sums) {
    constexpr int64_t AT_ONCE = 64;
    panoloc::for_each((poses + AT_ONCE - 1) / AT_ONCE, [&](int64_t share) {
        for (int64_t k = share * AT_ONCE; k < std::min(poses, (share + 1) * AT_ONCE); ++k) {
            const int8_t* view = views + starts[k] * patches * size;
            const int64_t* on = met + rotations[k] * count;
            float sum = 0;
            for (int64_t q = 0; q < count; ++q) {
                const float* own = descriptors + q * size;
                const int8_t* other = view + on[q] * size;
                for (int64_t d = 0; d < size; ++d) sum += own[d] * float(other[d]);
            }
            sums[k] = sum;
        }
    });
}

// Write the numbers of poses that are near none before them that is kept, at most `most`; return how many there are.
extern "C" int64_t first_distinct(const float* rotations, const float* positions, const int64_t* groups, int64_t poses, float least_trace,
    float distance_m, int64_t most, int64_t* kept) {
    int64_t count = 0;
    for (int64_t k = 0; k < poses && count < most; ++k) {
        bool is_near = false;
        for (int64_t n = 0; n < count && !is_near; ++n) {
            const int64_t other = kept[n];
            if (groups && groups[k] != groups[other]) continue;
            float square = 0, trace = 0;
            for (int c = 0; c < 3; ++c) {
                const float off = positions[3 * k + c] - positions[3 * other + c];
                square += off * off;
            }
            if (square >= distance_m * distance_m) continue;
            for (int c = 0; c < 9; ++c) trace += rotations[9 * k + c] * rotations[9 * other + c];
            is_near = trace > least_trace;
        }
        if (!is_near) kept[count++] = k;
    }
    return count;
}
