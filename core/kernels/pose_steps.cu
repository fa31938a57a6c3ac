// Steps of refinement on a GPU: what step.cpp says, one block of threads for each candidate, one warp for each patch at a time, all steps in
// one launch. panoloc.core.kernels.cuda compiles it; tests do so for processors, as warps of one thread.

#include "pose_move.h"

#ifdef __CUDACC__
#define WARP 32
using Float4 = float4;
#endif

#define EACH_LANE for (int lane_step = WARP / 2; lane_step; lane_step /= 2)

namespace panoloc {

const float PI = 3.14159265358979f;
const float FEWEST_POINTS = 5, MOST_CORRELATED = 0.999f, LEAST_RATIO = 1e-4f, LEAST_COSINE = 0.05f, VALID_SHARE = 0.99f;
const int MOST_ROWS = 8, MOST_WARPS = 12, PRODUCTS = MOST_ROWS * (MOST_ROWS + 1) / 2, BINS = 256;

// Planes of N numbers each that a step leaves for its second pass.
enum Plane { FOCAL, FOCAL_UP, ACROSS, UP = ACROSS + 3, IN_RIG = UP + 3, SHOWN = IN_RIG + 3, BY_AZIMUTH = SHOWN + 3,
    BY_ELEVATION = BY_AZIMUTH + 3, RESIDUAL = BY_ELEVATION + 3, VOTE = RESIDUAL + 3, RELATIVE };

struct Level {
    const float *pixels, *places, *rotations, *centers;
    long long width, images;
    float per_rad;
};

struct Points {
    const float *positions, *colors, *weights;
    const long long *images, *starts;
    long long count, patches;
};

// What the threads of a block share.
struct Shared {
    float rotation[9], position[3], log_focal;
    float products[MOST_WARPS][PRODUCTS], mass[MOST_WARPS], loss[MOST_WARPS];
    unsigned histogram[BINS], chosen, rank;
};

__device__ float warp_sum(float value) {
    EACH_LANE value += __shfl_xor_sync(~0u, value, lane_step);
    return value;
}

__device__ Float4 mixed(Float4 a, float u, Float4 b, float v) {
    return {u * a.x + v * b.x, u * a.y + v * b.y, u * a.z + v * b.z, u * a.w + v * b.w};
}

// The difference of two pixels where both are valid.
__device__ Float4 change(Float4 a, Float4 b) {
    const float valid = a.w * b.w;
    return {valid * (a.x - b.x), valid * (a.y - b.y), valid * (a.z - b.z), 0};
}

__device__ Float4 bilinear(Float4 a, Float4 b, Float4 c, Float4 d, float u, float v) {
    return mixed(mixed(a, 1 - u, b, u), 1 - v, mixed(c, 1 - u, d, u), v);
}

// Project point i, sample what is shown there, and keep both; return its weight, zero beside what is valid.
__device__ float look_at(const Level& level, const Points& points, const Shared& pose, float factor, long long i, float* planes) {
    const long long n = points.count, image = points.images ? points.images[i] : 0;
    const float *r = pose.rotation, *c = level.rotations + 9 * image, *center = level.centers + 3 * image, *place = level.places + image;
    const float mx = points.positions[i] - pose.position[0], my = points.positions[n + i] - pose.position[1];
    const float mz = points.positions[2 * n + i] - pose.position[2];
    float q[3], in_camera[3];
    for (int k = 0; k < 3; ++k) q[k] = r[k] * mx + r[3 + k] * my + r[6 + k] * mz;
    for (int k = 0; k < 3; ++k) {
        in_camera[k] = c[k] * (q[0] - center[0]) + c[3 + k] * (q[1] - center[1]) + c[6 + k] * (q[2] - center[2]);
        if (k) in_camera[k] *= factor;  // a longer focal length spreads what is beside the optical axis
        planes[(IN_RIG + k) * n + i] = q[k];
    }
    const float x = in_camera[0], y = in_camera[1], z = in_camera[2];
    const float flat_square = x * x + y * y, flat = sqrtf(flat_square), square = fmaxf(flat_square + z * z, 1e-12f);
    const float stable = fmaxf(flat_square, square * (LEAST_COSINE * LEAST_COSINE)), over = z / (fmaxf(flat, 1e-6f) * square);
    const float ax = -y / stable, ay = x / stable, ux = -x * over, uy = -y * over, uz = flat / square;
    planes[FOCAL * n + i] = ay * y;
    planes[FOCAL_UP * n + i] = uy * y + uz * z;
    for (int k = 0; k < 3; ++k) {
        planes[(ACROSS + k) * n + i] = c[3 * k] * ax + c[3 * k + 1] * (ay * factor);
        planes[(UP + k) * n + i] = c[3 * k] * ux + c[3 * k + 1] * (uy * factor) + c[3 * k + 2] * (uz * factor);
    }
    // One more for the outer border; what is no number becomes 0.
    const float column = fminf(fmaxf((PI - atan2f(y, x)) * level.per_rad - place[0], 0.0f), place[2 * level.images]) + 1;
    const float row = fminf(fmaxf((PI / 2 - atan2f(z, flat)) * level.per_rad - place[level.images], 0.0f), place[3 * level.images]) + 1
        + place[4 * level.images];
    const float left = floorf(column), top = floorf(row), u = column - left, v = row - top;
    const long long line = level.width;
    const Float4* at = reinterpret_cast<const Float4*>(level.pixels) + (long long)top * line + (long long)left;
    const Float4 p1 = at[0], p2 = at[1], q1 = at[line], q2 = at[line + 1], color = bilinear(p1, p2, q1, q2, u, v);
    const float weight = color.w > VALID_SHARE ? points.weights[i] : 0;
    Float4 by_azimuth = {0, 0, 0, 0}, by_elevation = {0, 0, 0, 0};
    if (weight > 0) {
        // Columns run against the azimuth, rows against the elevation; beside what is not valid nothing is known.
        by_azimuth = bilinear(
            change(at[-1], p2), change(p1, at[2]), change(at[line - 1], q2), change(q1, at[line + 2]), u, v);
        by_elevation = bilinear(
            change(at[-line], q1), change(at[1 - line], q2), change(p1, at[2 * line]), change(p2, at[2 * line + 1]), u, v);
    }
    const float shown[3] = {color.x, color.y, color.z}, per_rad = level.per_rad / 2;
    const float across[3] = {by_azimuth.x, by_azimuth.y, by_azimuth.z}, up[3] = {by_elevation.x, by_elevation.y, by_elevation.z};
    for (int k = 0; k < 3; ++k) {
        planes[(SHOWN + k) * n + i] = shown[k];
        planes[(BY_AZIMUTH + k) * n + i] = per_rad * across[k];
        planes[(BY_ELEVATION + k) * n + i] = per_rad * up[k];
    }
    planes[VOTE * n + i] = weight;
    return weight;
}

// Project the points of a patch, centre both sides, fit its gain, and let it vote the more the more it agrees. All lanes of a warp.
__device__ void compare(const Level& level, const Points& points, Shared& shared, float factor, float noise, long long patch, int lane,
    int warp, float* planes) {
    const long long n = points.count, first = points.starts[patch] + lane, end = points.starts[patch + 1];
    float total = 0, shown_mean[3] = {0, 0, 0}, scanned_mean[3] = {0, 0, 0};
    for (long long i = first; i < end; i += WARP) {
        const float weight = look_at(level, points, shared, factor, i, planes);
        total += weight;
        for (int c = 0; c < 3; ++c) {
            shown_mean[c] += weight * planes[(SHOWN + c) * n + i];
            scanned_mean[c] += weight * points.colors[c * n + i];
        }
    }
    total = fmaxf(warp_sum(total), 1e-6f);
    for (int c = 0; c < 3; ++c) shown_mean[c] = warp_sum(shown_mean[c]) / total, scanned_mean[c] = warp_sum(scanned_mean[c]) / total;
    float common = 0, shown_power = 0, scanned_power = 0;
    for (long long i = first; i < end; i += WARP) {
        const float weight = planes[VOTE * n + i];
        for (int c = 0; c < 3; ++c) {
            const float shown = planes[(SHOWN + c) * n + i] -= shown_mean[c], scanned = points.colors[c * n + i] - scanned_mean[c];
            common += weight * shown * scanned;
            shown_power += weight * shown * shown, scanned_power += weight * scanned * scanned;
        }
    }
    common = warp_sum(common) / total;
    shown_power = warp_sum(shown_power) / total + noise, scanned_power = warp_sum(scanned_power) / total + noise;
    const float correlation = fminf(fmaxf(common / sqrtf(shown_power * scanned_power), 0.0f), MOST_CORRELATED);
    const float unexplained = sqrtf(1 - correlation * correlation), gain = fmaxf(common / shown_power, 0.0f);
    const float vote = total > FEWEST_POINTS ? 1 / (unexplained * scanned_power) : 0;
    for (long long i = first; i < end; i += WARP) {
        float relative = 0;
        for (int c = 0; c < 3; ++c) {
            const float residual = gain * planes[(SHOWN + c) * n + i] - (points.colors[c * n + i] - scanned_mean[c]);
            planes[(RESIDUAL + c) * n + i] = residual;
            planes[(BY_AZIMUTH + c) * n + i] *= gain, planes[(BY_ELEVATION + c) * n + i] *= gain;
            relative += residual * residual / scanned_power;
        }
        // What is not seen is told from what fits: it has no part in the median.
        planes[RELATIVE * n + i] = planes[VOTE * n + i] > 0 ? relative : -1;
        planes[VOTE * n + i] *= vote;
    }
    if (lane == 0) shared.mass[warp] += total, shared.loss[warp] += total * unexplained;
}

// The median of the residuals of what is seen, 1 of none: byte after byte of it, by counting. All threads of a block.
__device__ float median_of(const float* relative, long long count, Shared& shared, int lane, int warp) {
    unsigned prefix = 0, mask = 0;
    for (int shift = 24; shift >= 0; shift -= 8) {
        for (int bin = threadIdx.x; bin < BINS; bin += blockDim.x) shared.histogram[bin] = 0;
        __syncthreads();
        for (long long i = threadIdx.x; i < count; i += blockDim.x) {
            const unsigned bits = __float_as_uint(relative[i]);
            if (relative[i] >= 0 && (bits & mask) == prefix) atomicAdd(&shared.histogram[bits >> shift & 255], 1u);
        }
        __syncthreads();
        if (warp == 0) {
            const int each = BINS / WARP;
            unsigned own = 0, before = 0, all = 0;
            for (int k = 0; k < each; ++k) own += shared.histogram[lane * each + k];
            for (int other = 0; other < WARP; ++other) {
                const unsigned theirs = __shfl_sync(~0u, own, other);
                if (other < lane) before += theirs;
                all += theirs;
            }
            if (shift == 24 && lane == 0) shared.rank = all ? (all - 1) / 2 : ~0u;
            __syncwarp();
            const unsigned rank = shared.rank;
            __syncwarp();
            if (rank != ~0u && before <= rank && rank < before + own) {
                int bin = lane * each;
                for (; before + shared.histogram[bin] <= rank; ++bin) before += shared.histogram[bin];
                shared.chosen = bin, shared.rank = rank - before;
            }
        }
        __syncthreads();
        if (shared.rank == ~0u) return 1;
        prefix |= shared.chosen << shift, mask |= 255u << shift;
    }
    return __uint_as_float(prefix);
}

// The parts of the normal equations that one warp sums up, less what offsets and gain of each patch would undo (variable projection).
template <int UNKNOWNS>
__device__ void add_patch(const Points& points, long long patch, float per, int lane, const float* planes, float* products) {
    const int ROWS = UNKNOWNS + 1;  // the residual is one more
    const long long n = points.count, end = points.starts[patch + 1];
    float offsets[ROWS][4] = {}, total = 0, power = 0;  // the last of each four: by the gain
    for (long long i = points.starts[patch] + lane; i < end; i += WARP) {
        // Points count less whose residuals are large against the median (Geman-McClure).
        const float one = 1 + fmaxf(planes[RELATIVE * n + i], 0.0f) * per, weight = planes[VOTE * n + i] / (one * one);
        if (weight == 0) continue;
        float across[3], up[3], in_rig[3];
        for (int k = 0; k < 3; ++k)
            across[k] = planes[(ACROSS + k) * n + i], up[k] = planes[(UP + k) * n + i], in_rig[k] = planes[(IN_RIG + k) * n + i];
        total += weight;
        for (int c = 0; c < 3; ++c) {
            const float by_azimuth = planes[(BY_AZIMUTH + c) * n + i], by_elevation = planes[(BY_ELEVATION + c) * n + i];
            const float shown = planes[(SHOWN + c) * n + i];
            float by_point[3], rows[ROWS];
            for (int k = 0; k < 3; ++k) by_point[k] = by_azimuth * across[k] + by_elevation * up[k];
            // A turn ω and a move τ of the rig take a point q of it to q − ω × q − τ.
            for (int k = 0; k < 3; ++k) {
                rows[k] = by_point[(k + 1) % 3] * in_rig[(k + 2) % 3] - by_point[(k + 2) % 3] * in_rig[(k + 1) % 3];
                rows[3 + k] = -by_point[k];
            }
            if (UNKNOWNS == 7) rows[6] = by_azimuth * planes[FOCAL * n + i] + by_elevation * planes[FOCAL_UP * n + i];
            rows[UNKNOWNS] = planes[(RESIDUAL + c) * n + i];
            power += weight * shown * shown;
#pragma unroll
            for (int r = 0, product = 0; r < ROWS; ++r) {
                const float weighted = weight * rows[r];
                offsets[r][c] += weighted, offsets[r][3] += weighted * shown;
#pragma unroll
                for (int s = 0; s <= r; ++s, ++product) products[product] += weighted * rows[s];
            }
        }
    }
    const float per_total = rsqrtf(fmaxf(warp_sum(total), 1e-9f)), per_power = rsqrtf(fmaxf(warp_sum(power), 1e-9f));
#pragma unroll
    for (int r = 0; r < ROWS; ++r)
#pragma unroll
        for (int c = 0; c < 4; ++c) offsets[r][c] = warp_sum(offsets[r][c]) * (c < 3 ? per_total : per_power);
    if (lane == 0)
#pragma unroll
        for (int r = 0, product = 0; r < ROWS; ++r)
#pragma unroll
            for (int s = 0; s <= r; ++s, ++product)
                if (s < UNKNOWNS)  // the residual's own square stays what it is
                    for (int c = 0; c < 4; ++c) products[product] -= offsets[r][c] * offsets[s][c];
}

template <int UNKNOWNS>
__device__ void equations(const Level& level, const Points& points, Shared& shared, float factor, const Rules& rules, float* planes,
    float* hessian, float* gradient, float* mass, float* loss, float* scale) {
    const int lane = threadIdx.x % WARP, warp = threadIdx.x / WARP, warps = blockDim.x / WARP, ROWS = UNKNOWNS + 1;
    if (lane == 0) shared.mass[warp] = shared.loss[warp] = 0;
    __syncwarp();
    for (long long patch = warp; patch < points.patches; patch += warps)
        compare(level, points, shared, factor, rules.noise, patch, lane, warp, planes);
    __syncthreads();
    float per = 0;
    if (rules.robust_scale > 0) {
        const float median = median_of(planes + RELATIVE * points.count, points.count, shared, lane, warp);
        per = 1 / (rules.robust_scale * rules.robust_scale * fmaxf(median, LEAST_RATIO));
    }
    float products[ROWS * (ROWS + 1) / 2] = {};
    for (long long patch = warp; patch < points.patches; patch += warps)
        add_patch<UNKNOWNS>(points, patch, per, lane, planes, products);
#pragma unroll
    for (int k = 0; k < ROWS * (ROWS + 1) / 2; ++k) {
        const float sum = warp_sum(products[k]);
        if (lane == 0) shared.products[warp][k] = sum;
    }
    __syncthreads();
    // A number for each thread, the residual's own square last.
    for (int k = threadIdx.x; k < ROWS * ROWS; k += blockDim.x) {
        const int r = k / ROWS, s = k % ROWS;
        if (s > r) continue;
        float sum = 0, total = 0, lost = 0;
        for (int each = 0; each < warps; ++each) sum += shared.products[each][r * (r + 1) / 2 + s];
        if (r < UNKNOWNS) hessian[r * UNKNOWNS + s] = hessian[s * UNKNOWNS + r] = sum;
        else if (s < UNKNOWNS) gradient[s] = sum;
        else {
            for (int each = 0; each < warps; ++each) total += shared.mass[each], lost += shared.loss[each];
            *mass = fmaxf(total, 1e-9f), *loss = lost / *mass, *scale = sqrtf(sum / *mass);
        }
    }
    __syncthreads();
}

template <int UNKNOWNS>
__device__ void steps_of(const Level& level, const Points& points, Shared& shared, const Rules& rules, long long steps, bool has_focal,
    float* planes, float* hessian, float* gradient, float* mass, float* loss, float* scale, float* step) {
    for (long long done = 0; done < (steps ? steps : 1); ++done) {
        const float factor = has_focal ? expf(shared.log_focal) : 1;
        equations<UNKNOWNS>(level, points, shared, factor, rules, planes, hessian, gradient, mass, loss, scale);
        if (steps && threadIdx.x == 0) {
            const bool is_last = rules.has_last && done + 1 == steps;
            move<UNKNOWNS>(hessian, gradient, rules, is_last, shared.rotation, shared.position, &shared.log_focal, step);
        }
        __syncthreads();
    }
}

}  // namespace panoloc

// As in step.cpp. memory: (candidates, 25, count).
extern "C" __global__ void __launch_bounds__(32 * panoloc::MOST_WARPS) pose_steps(const float* pixels, long long width, long long rows,
    const float* places, const float* camera_rotations, const float* centers, long long images, const float* positions,
    const float* colors, const float* weights, const long long* shown_by, const long long* starts, long long count, long long patches,
    long long candidates, float* rotations, float* at, float* log_focals, long long unknowns, float robust_scale, float noise,
    float damping, float lengthening, float max_step_m, float least_log_focal, float most_log_focal, long long steps,
    long long has_last, float* hessian, float* gradient, float* mass, float* loss, float* scale, float* step, float* memory) {
    using namespace panoloc;
    __shared__ Shared shared;
    const long long k = blockIdx.x;
    const Level level = {pixels, places, camera_rotations, centers, width, images, float(rows) / PI};
    const Rules rules = {robust_scale, noise, damping, lengthening, max_step_m, least_log_focal, most_log_focal, has_last != 0};
    const Points points = {positions + 3 * k * count, colors + 3 * k * count, weights + k * count, shown_by ? shown_by + k * count : 0,
        starts, count, patches};
    if (threadIdx.x == 0) {
        for (int each = 0; each < 9; ++each) shared.rotation[each] = rotations[9 * k + each];
        for (int each = 0; each < 3; ++each) shared.position[each] = at[3 * k + each];
        shared.log_focal = log_focals ? log_focals[k] : 0;
    }
    __syncthreads();
    float *planes = memory + k * (RELATIVE + 1) * count, *h = hessian + unknowns * unknowns * k, *g = gradient + unknowns * k;
    float* moved = step + unknowns * k;
    if (unknowns == 7)
        steps_of<7>(level, points, shared, rules, steps, log_focals, planes, h, g, mass + k, loss + k, scale + k, moved);
    else
        steps_of<6>(level, points, shared, rules, steps, log_focals, planes, h, g, mass + k, loss + k, scale + k, moved);
    if (threadIdx.x == 0) {
        for (int each = 0; each < 9; ++each) rotations[9 * k + each] = shared.rotation[each];
        for (int each = 0; each < 3; ++each) at[3 * k + each] = shared.position[each];
        if (log_focals) log_focals[k] = shared.log_focal;
    }
}
