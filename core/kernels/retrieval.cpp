// Products of what a query shows with the retrieval vectors of all starts of many maps: panoloc.core.search.retrieval.

#include "kernels.h"

// Of M maps: addresses of their vectors (counts, size) of int8, how many these are, the number of the first of them in `scores`, and the
// number of the query's vectors (rotations, size) that each is compared with. scores: the best product of each start.
extern "C" void retrieval_scores(const int64_t* vectors, const int64_t* counts, const int64_t* firsts, const int64_t* numbers, int64_t maps,
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
