// What edges say of where vanishing points are: what panoloc.core.features.line_support says in tensors.

#include "kernels.h"

// Support (A,) of axes (A, 3) by the planes `normals` (E, 3) and places `directions` (E, 3) of edges: the mean logarithm by which edges are
// likelier with the axis than without. Edges whose plane misses an axis by the sine `reach` or more say nothing. spread: standard deviation of
// the direction of an edge, radians; peak: how much likelier an edge is that runs exactly there.
extern "C" void line_support(const float* axes, int64_t count, const float* normals, const float* directions, int64_t edges, float reach,
    float spread, float peak, float least_sine, float* support) {
    std::vector<float> planes(6 * edges);
    for (int64_t e = 0; e < edges; ++e)
        for (int64_t k = 0; k < 3; ++k) planes[k * edges + e] = normals[3 * e + k], planes[(3 + k) * edges + e] = directions[3 * e + k];
    const float per_square = -0.5f / (spread * spread * std::log(2.0f)), least = least_sine * least_sine;
    constexpr int64_t SHARE = 256;
    panoloc::for_each((count + SHARE - 1) / SHARE, [&](int64_t share) {
        const float *nx = planes.data(), *ny = nx + edges, *nz = ny + edges, *dx = nz + edges, *dy = dx + edges, *dz = dy + edges;
        std::vector<float> memory(4 * edges);
        float *off = memory.data(), *along = off + edges, *near = along + edges, *along_near = near + edges;
        for (int64_t a = share * SHARE; a < std::min(count, (share + 1) * SHARE); ++a) {
            const float x = axes[3 * a], y = axes[3 * a + 1], z = axes[3 * a + 2];
#pragma GCC ivdep
            for (int64_t e = 0; e < edges; ++e) {
                off[e] = nx[e] * x + ny[e] * y + nz[e] * z;
                along[e] = dx[e] * x + dy[e] * y + dz[e] * z;
            }
            // Few edges pass near an axis: these are gathered first.
            int64_t size = 0;
            for (int64_t e = 0; e < edges; ++e) {
                near[size] = off[e], along_near[size] = along[e];
                size += std::fabs(off[e]) < reach;
            }
            float sum = 0;  // of logarithms to base 2
            for (int64_t k = 0; k < size; ++k) {
                const float sine_square = 1 - along_near[k] * along_near[k], square = sine_square > least ? sine_square : least;
                sum += panoloc::log2_of(1 + peak * panoloc::exp2_of(near[k] * near[k] / square * per_square));
            }
            support[a] = sum * std::log(2.0f) / std::max<int64_t>(1, edges);
        }
    });
}
