// How well two images agree, over all of them and inside patches: what `agreement` of panoloc.core.decide.agreement says in tensors.

#include "kernels.h"

namespace panoloc {
namespace {

// Weighted sums over pixels of two images, per channel.
struct Sums {
    double weight = 0, first[3] = {}, second[3] = {}, first_square[3] = {}, second_square[3] = {}, product[3] = {};

    Sums& operator+=(const Sums& other) {
        weight += other.weight;
        for (int c = 0; c < 3; ++c) {
            first[c] += other.first[c], second[c] += other.second[c], product[c] += other.product[c];
            first_square[c] += other.first_square[c], second_square[c] += other.second_square[c];
        }
        return *this;
    }

    // Variances and covariance of a channel.
    void spread(int c, double& of_first, double& of_second, double& common) const {
        const double a = first[c] / weight, b = second[c] / weight;
        of_first = first_square[c] / weight - a * a, of_second = second_square[c] / weight - b * b, common = product[c] / weight - a * b;
    }
};

// Add a stretch of a row.
inline void add(const float* first, const float* second, const float* weights, int64_t count, Sums& sums) {
    Pixel a = {}, b = {}, sum_a = {}, sum_b = {}, sum_aa = {}, sum_bb = {}, sum_ab = {};
    float weight = 0;
    for (int64_t i = 0; i < count; ++i) {
        if (weights[i] == 0) continue;
        std::memcpy(&a, first + 3 * i, 12), std::memcpy(&b, second + 3 * i, 12);
        const Pixel wa = weights[i] * a, wb = weights[i] * b;
        weight += weights[i], sum_a += wa, sum_b += wb, sum_aa += wa * a, sum_bb += wb * b, sum_ab += wa * b;
    }
    sums.weight += weight;
    for (int c = 0; c < 3; ++c) {
        sums.first[c] += sum_a[c], sums.second[c] += sum_b[c], sums.product[c] += sum_ab[c];
        sums.first_square[c] += sum_aa[c], sums.second_square[c] += sum_bb[c];
    }
}

// The correlation over all channels together.
inline double correlation(const Sums& sums, double floor) {
    double of_first = floor, of_second = floor, common = 0, a, b, ab;
    for (int c = 0; c < 3; ++c) sums.spread(c, a, b, ab), of_first += a, of_second += b, common += ab;
    return common / std::sqrt(of_first * of_second);
}

}  // namespace
}  // namespace panoloc

// Of each of `views` pairs of images (height, width, 3) with weights (height, width): the sum of weights; the mean over channels of the correlation
// of all pixels; over patches of `side` pixels, and over those that begin half a side before, the means of the correlation inside, and of the share
// of contrast explained. measured: (views, 4). floor: variance below which contrast is noise.
extern "C" void agreement(const float* scan, const float* seen, const float* weights, int64_t views, int64_t height, int64_t width, int64_t side,
    float floor, float* measured) {
    using namespace panoloc;
    // Cells between the borders of both kinds of patches: of the first kind 2 i and 2 i + 1 are one, of the second 2 i − 1 and 2 i.
    const int64_t before = side / 2, rows = 2 * ((height + side - 1) / side) + 1, columns = 2 * ((width + side - 1) / side) + 1;
    const auto border = [&](int64_t cell) { return cell / 2 * side + (cell % 2 ? side - before : 0); };
    for_each(views, [&](int64_t k) {
        std::vector<Sums> cells(rows * columns);
        Sums all;
        for (int64_t r = 0; r < rows; ++r)
            for (int64_t y = border(r); y < std::min(height, border(r + 1)); ++y)
                for (int64_t c = 0; c < columns; ++c) {
                    const int64_t from = border(c), count = std::min(width, border(c + 1)) - from, at = (k * height + y) * width + from;
                    if (count > 0) add(scan + 3 * at, seen + 3 * at, weights + at, count, cells[r * columns + c]);
                }
        for (const Sums& cell : cells) all += cell;
        float* found = measured + 4 * k;
        found[0] = float(all.weight), found[1] = found[2] = found[3] = 0;
        if (all.weight <= 0) return;
        for (int c = 0; c < 3; ++c) {
            double a, b, ab;
            all.spread(c, a, b, ab);
            found[1] += float(ab / std::sqrt((a + floor) * (b + floor)) / 3);
        }
        double inside = 0, explained = 0;
        for (int64_t kind = 0; kind < 2; ++kind)
            for (int64_t r = -kind; r < rows; r += 2)
                for (int64_t c = -kind; c < columns; c += 2) {
                    Sums patch;
                    for (int64_t i = std::max<int64_t>(r, 0); i < std::min(r + 2, rows); ++i)
                        for (int64_t j = std::max<int64_t>(c, 0); j < std::min(c + 2, columns); ++j) patch += cells[i * columns + j];
                    if (patch.weight <= 0) continue;
                    const double share = patch.weight / all.weight / 2, agrees = correlation(patch, floor);
                    inside += share * agrees;
                    const double clamped = std::min(1.0, std::max(0.0, agrees));
                    explained += share * (1 - std::sqrt(1 - clamped * clamped));
                }
        found[2] = float(inside), found[3] = float(explained);
    });
}
