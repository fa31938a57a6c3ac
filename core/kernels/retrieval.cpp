// What a query shows against the retrieval vectors of all starts of many maps: panoloc.core.search.retrieval.

#include "kernels.h"

namespace panoloc {
namespace {

// Starts that are compared together: as many as fit into one vector of the processor, for comparisons of longer ones are made one by one.
#if defined(__AVX512BW__)
constexpr int LANES = 32;
#elif defined(__AVX2__)
constexpr int LANES = 16;
#else
constexpr int LANES = 8;
#endif
constexpr int8_t UNSEEN = std::numeric_limits<int8_t>::min();
using Bytes = int8_t __attribute__((vector_size(LANES)));
using Lanes = int16_t __attribute__((vector_size(2 * LANES)));

// S pixels of a query: levels (S, 3), and the most that a difference counts.
struct Query {
    const int8_t* levels;
    int64_t size;
    int16_t most;
};

// The levels of a pixel, and where anything was seen: all bits, else none.
struct Shown {
    Lanes levels[3], seen;
    explicit Shown(const Bytes* from) {
        for (int c = 0; c < 3; ++c) levels[c] = __builtin_convertvector(from[c], Lanes);
        seen = levels[0] != Lanes{} + UNSEEN;
    }
};

// By how many levels the starts are off whose levels (P, 3) are `shown`, where pixel s of the query lies at `at[s]`.
inline Lanes off_under(const Query& query, const Bytes* shown, const int32_t* at) {
    Lanes sums[3] = {}, count = {}, lights[3], off = {};
    for (int64_t s = 0; s < query.size; ++s) {
        const Shown one(shown + 3 * at[s]);
        count -= one.seen;
        for (int c = 0; c < 3; ++c) sums[c] += (one.levels[c] - query.levels[3 * s + c]) & one.seen;
    }
    for (int c = 0; c < 3; ++c)
        for (int k = 0; k < LANES; ++k) lights[c][k] = int16_t(std::nearbyint(float(sums[c][k]) / float(std::max<int16_t>(count[k], 1))));
    for (int64_t s = 0; s < query.size; ++s) {
        const Shown one(shown + 3 * at[s]);
        Lanes all = {};
        for (int c = 0; c < 3; ++c) {
            const Lanes left = one.levels[c] - (lights[c] + query.levels[3 * s + c]);
            const Lanes size = left < 0 ? -left : left, most = Lanes{} + query.most;
            all += size < most ? size : most;
        }
        off += one.seen ? all : Lanes{} + int16_t(3 * query.most);
    }
    return off;
}

}  // namespace
}  // namespace panoloc

// Of M maps: addresses of their levels (P, 3, counts) of int8, how many starts these are of, the number of the first of them in `off`, and the
// axes of their walls (3, 3). towards: (rotations, size, 3), in those axes, where the pixels of the query look under each rotation.
// off: by how many levels each start is off under the best one.
extern "C" void retrieval_by_pixels(const int64_t* levels, const int64_t* counts, const int64_t* firsts, const float* axes, int64_t maps, int64_t rows,
    const int8_t* own, const float* towards, int64_t rotations, int64_t size, int64_t most, float* off) {
    using namespace panoloc;
    const Query query{own, size, int16_t(most)};
    for_each(maps, [&](int64_t m) {
        const auto* all = reinterpret_cast<const int8_t*>(levels[m]);
        const float* axis = axes + 9 * m;
        std::vector<int32_t> at(rotations * size);
#pragma GCC ivdep
        for (int64_t k = 0; k < rotations * size; ++k) {
            const float *t = towards + 3 * k;
            at[k] = pixel_towards(t[0] * axis[0] + t[1] * axis[3] + t[2] * axis[6], t[0] * axis[1] + t[1] * axis[4] + t[2] * axis[7],
                t[0] * axis[2] + t[1] * axis[5] + t[2] * axis[8], int32_t(rows));
        }
        std::vector<Bytes> shown(3 * 2 * rows * rows);
        for (int64_t first = 0; first < counts[m]; first += LANES) {
            const int64_t count = std::min<int64_t>(LANES, counts[m] - first);
            for (size_t k = 0; k < shown.size(); ++k) std::memcpy(&shown[k], all + k * counts[m] + first, count);
            Lanes best = Lanes{} + std::numeric_limits<int16_t>::max();
            for (int64_t r = 0; r < rotations; ++r) {
                const Lanes one = off_under(query, shown.data(), at.data() + r * size);
                best = one < best ? one : best;
            }
            for (int64_t k = 0; k < count; ++k) off[firsts[m] + first + k] = best[k];
        }
    });
}

// Of M maps: addresses of their vectors (counts, size) of int8, how many these are, the number of the first of them in `scores`, and the
// number of the query's vectors (rotations, size) that each is compared with. scores: the best product of each start.
extern "C" void retrieval_by_patches(const int64_t* vectors, const int64_t* counts, const int64_t* firsts, const int64_t* numbers, int64_t maps,
    const int16_t* queries, int64_t rotations, int64_t size, float* scores) {
    panoloc::for_each(maps, [&](int64_t m) {
        const auto* vector = reinterpret_cast<const int8_t*>(vectors[m]);
        const int16_t* query = queries + numbers[m] * rotations * size;
        std::vector<int16_t> shown(size);
        for (int64_t start = 0; start < counts[m]; ++start, vector += size) {
            for (int64_t i = 0; i < size; ++i) shown[i] = vector[i];
            int32_t best = std::numeric_limits<int32_t>::min();
            for (int64_t r = 0; r < rotations; ++r) {
                const int16_t *one = shown.data(), *other = query + r * size;
                int32_t sum = 0;
                for (int64_t i = 0; i < size; ++i) sum += int32_t(one[i]) * other[i];
                best = sum > best ? sum : best;
            }
            scores[firsts[m] + start] = float(best);
        }
    });
}
