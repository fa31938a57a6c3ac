// The equations of a step of refinement, for one candidate after the other: what `patch_equations` of panoloc.core.refine.step says in
// tensors, without planes in between. A point is projected, its colour and derivatives are taken from 12 pixels, and patches are summed up
// as they lie in memory.

#include "kernels.h"
#include "pose_move.h"

namespace panoloc {
namespace {

#if defined(__AVX512F__)
constexpr int LANES = 16;
#else
constexpr int LANES = 8;
#endif
using Lanes = float __attribute__((vector_size(4 * LANES)));

constexpr float FEWEST_POINTS = 5, MOST_CORRELATED = 0.999f, LEAST_RATIO = 1e-4f;
constexpr float LEAST_COSINE = 0.05f;

// N points of one candidate, in the order of their P patches; see `PointPlanes`.
struct Points {
    const float *positions, *colors, *weights;
    const int64_t *images, *starts;
    int64_t count, patches;
};

Lanes load(const float* from) {
    Lanes lanes;
    std::memcpy(&lanes, from, sizeof lanes);
    return lanes;
}

float sum_of(const Lanes& lanes) {
    float each[LANES], sum = 0;
    std::memcpy(each, &lanes, sizeof each);
    for (int k = 0; k < LANES; ++k) sum += each[k];
    return sum;
}

// Planes of N numbers each, one row of memory after the other.
enum Plane { COLUMN, ROW, FOCAL, FOCAL_UP, ACROSS, UP = ACROSS + 3, IN_RIG = UP + 3, SHOWN = IN_RIG + 3, BY_AZIMUTH = SHOWN + 3,
    BY_ELEVATION = BY_AZIMUTH + 3, SCANNED = BY_ELEVATION + 3, RESIDUAL = SCANNED + 3, WEIGHT = RESIDUAL + 3, VOTE, RELATIVE, PLANES };

class Equations {
  public:
    Equations(const Level& level, const Points& points, std::vector<float>& memory) : level_(level), points_(points) {
        stride_ = (points.count + 2 * LANES) & ~int64_t(LANES - 1);
        if (memory.size() < size_t(PLANES * stride_)) memory.resize(PLANES * stride_);
        memory_ = memory.data();
        // What lanes beyond the last point read must be finite, though it weighs nothing.
        for (int k = 0; k < PLANES; ++k) std::fill_n(plane(k) + points.count, LANES, 0.0f);
    }

    float* plane(int which) const { return memory_ + which * stride_; }

    // Where points project to, and the derivatives of azimuth and elevation by the point in the axes of the rig.
    template <bool ALONE> void project(const float* rotation, const float* position, float factor) {
        const int64_t n = points_.count, images = level_.images;
        const float *px = points_.positions, *py = px + n, *pz = py + n, *places = level_.places, per_rad = level_.per_rad;
        const float *cameras = level_.rotations, *centers = level_.centers;
        float *columns = plane(COLUMN), *rows = plane(ROW), *focal = plane(FOCAL), *focal_up = plane(FOCAL_UP);
        float *across = plane(ACROSS), *up = plane(UP), *in_rig = plane(IN_RIG);
        const int64_t stride = stride_;
        float r[9], t[3];
        std::copy_n(rotation, 9, r), std::copy_n(position, 3, t);
        // In 32 bits, as wide as the numbers that are gathered by them.
        auto* image_of = reinterpret_cast<int32_t*>(plane(RELATIVE));
        for (int64_t i = 0; i < (ALONE ? 0 : n); ++i) image_of[i] = int32_t(points_.images[i]);
#pragma GCC ivdep
        for (int64_t i = 0; i < n; ++i) {
            const int32_t image = ALONE ? 0 : image_of[i];
            const float *c = cameras + 9 * image, *center = centers + 3 * image, *place = places + image;
            const float mx = px[i] - t[0], my = py[i] - t[1], mz = pz[i] - t[2];
            const float qx = r[0] * mx + r[3] * my + r[6] * mz;
            const float qy = r[1] * mx + r[4] * my + r[7] * mz;
            const float qz = r[2] * mx + r[5] * my + r[8] * mz;
            const float rx = qx - center[0], ry = qy - center[1], rz = qz - center[2];
            const float x = c[0] * rx + c[3] * ry + c[6] * rz;
            // A longer focal length spreads what is beside the optical axis.
            const float y = factor * (c[1] * rx + c[4] * ry + c[7] * rz);
            const float z = factor * (c[2] * rx + c[5] * ry + c[8] * rz);
            const float flat_square = x * x + y * y, flat = std::sqrt(flat_square);
            const float square = std::max(flat_square + z * z, 1e-12f);
            const float stable = std::max(flat_square, square * (LEAST_COSINE * LEAST_COSINE));
            const float over = z / (std::max(flat, 1e-6f) * square);
            const float ax = -y / stable, ay = x / stable, ux = -x * over, uy = -y * over, uz = flat / square;
            const float column = (PI - angle_of(y, x)) * per_rad - place[0];
            const float row = (PI / 2 - angle_of(z, flat)) * per_rad - place[images];
            // One more for the outer border; what is no number becomes 0.
            const float last_column = place[2 * images], last_row = place[3 * images];
            columns[i] = (column > 0 ? column < last_column ? column : last_column : 0) + 1;
            rows[i] = (row > 0 ? row < last_row ? row : last_row : 0) + 1 + place[4 * images];
            focal[i] = ay * y;
            focal_up[i] = uy * y + uz * z;
            for (int k = 0; k < 3; ++k) {
                across[k * stride + i] = c[3 * k] * ax + c[3 * k + 1] * (ay * factor);
                up[k * stride + i] = c[3 * k] * ux + c[3 * k + 1] * (uy * factor) + c[3 * k + 2] * (uz * factor);
            }
            in_rig[i] = qx, in_rig[stride + i] = qy, in_rig[2 * stride + i] = qz;
        }
    }

    // What images show there: colours and their derivatives per radian, bilinear, and weights of zero beside what is valid.
    void sample() {
        const int64_t line = 4 * level_.width;
        for (int64_t i = 0; i < points_.count; ++i) {
            const float column = plane(COLUMN)[i], row = plane(ROW)[i];
            const float left = std::floor(column), top = std::floor(row), u = column - left, v = row - top;
            const float w00 = (1 - u) * (1 - v), w01 = u * (1 - v), w10 = (1 - u) * v, w11 = u * v;
            const float* at = level_.pixels + int64_t(top) * line + 4 * int64_t(left);
            const Pixel p1 = pixel_at(at), p2 = pixel_at(at + 4), q1 = pixel_at(at + line), q2 = pixel_at(at + line + 4);
            const Pixel color = w00 * p1 + w01 * p2 + w10 * q1 + w11 * q2;
            const float weight = color[3] > VALID_SHARE ? points_.weights[i] : 0;
            Pixel across = {}, up = {};
            if (weight > 0) {
                const Pixel p0 = pixel_at(at - 4), p3 = pixel_at(at + 8), q0 = pixel_at(at + line - 4), q3 = pixel_at(at + line + 8);
                const Pixel a1 = pixel_at(at - line), a2 = pixel_at(at - line + 4);
                const Pixel b1 = pixel_at(at + 2 * line), b2 = pixel_at(at + 2 * line + 4);
                // Columns run against the azimuth, rows against the elevation; beside what is not valid nothing is known.
                across = w00 * p0[3] * p2[3] * (p0 - p2) + w01 * p1[3] * p3[3] * (p1 - p3)
                    + w10 * q0[3] * q2[3] * (q0 - q2) + w11 * q1[3] * q3[3] * (q1 - q3);
                up = w00 * a1[3] * q1[3] * (a1 - q1) + w01 * a2[3] * q2[3] * (a2 - q2)
                    + w10 * p1[3] * b1[3] * (p1 - b1) + w11 * p2[3] * b2[3] * (p2 - b2);
            }
            const float per_rad = level_.per_rad / 2;
            for (int c = 0; c < 3; ++c) {
                plane(SHOWN + c)[i] = color[c];
                plane(BY_AZIMUTH + c)[i] = per_rad * across[c];
                plane(BY_ELEVATION + c)[i] = per_rad * up[c];
            }
            plane(WEIGHT)[i] = weight;
        }
    }

    // Centre both sides in every patch, fit its gain, and let it vote the more the more it agrees.
    void compare(float noise) {
        mass = loss = 0;
        for (int64_t p = 0; p < points_.patches; ++p) {
            const int64_t first = points_.starts[p], end = points_.starts[p + 1];
            const float* weight = plane(WEIGHT);
            float total = 0;
            for (int64_t i = first; i < end; ++i) total += weight[i];
            total = std::max(total, 1e-6f);
            float common = 0, shown_power = 0, scanned_power = 0;
            for (int c = 0; c < 3; ++c) {
                float *shown = plane(SHOWN + c), *scanned = plane(SCANNED + c);
                const float* colors = points_.colors + c * points_.count;
                float shown_mean = 0, scanned_mean = 0;
                for (int64_t i = first; i < end; ++i) shown_mean += weight[i] * shown[i], scanned_mean += weight[i] * colors[i];
                shown_mean /= total, scanned_mean /= total;
                for (int64_t i = first; i < end; ++i) {
                    shown[i] -= shown_mean, scanned[i] = colors[i] - scanned_mean;
                    common += weight[i] * shown[i] * scanned[i];
                    shown_power += weight[i] * shown[i] * shown[i], scanned_power += weight[i] * scanned[i] * scanned[i];
                }
            }
            common /= total, shown_power = shown_power / total + noise, scanned_power = scanned_power / total + noise;
            const float correlation = std::min(std::max(common / std::sqrt(shown_power * scanned_power), 0.0f), MOST_CORRELATED);
            const float unexplained = std::sqrt(1 - correlation * correlation), gain = std::max(common / shown_power, 0.0f);
            const float vote = total > FEWEST_POINTS ? 1 / (unexplained * scanned_power) : 0;
            float *voting = plane(VOTE), *relative = plane(RELATIVE);
            for (int64_t i = first; i < end; ++i) voting[i] = weight[i] * vote, relative[i] = 0;
            for (int c = 0; c < 3; ++c) {
                const float *shown = plane(SHOWN + c), *scanned = plane(SCANNED + c);
                float *by_azimuth = plane(BY_AZIMUTH + c), *by_elevation = plane(BY_ELEVATION + c), *residual = plane(RESIDUAL + c);
#pragma GCC ivdep
                for (int64_t i = first; i < end; ++i) {
                    residual[i] = gain * shown[i] - scanned[i];
                    relative[i] += residual[i] * residual[i] / scanned_power;
                    by_azimuth[i] *= gain, by_elevation[i] *= gain;
                }
            }
            mass += total, loss += total * unexplained;
        }
        mass = std::max(mass, 1e-9f), loss /= mass;
    }

    // Let points count less whose residuals are large against the median (Geman-McClure).
    void weigh_robustly(float robust_scale) {
        std::vector<float> seen;
        for (int64_t i = 0; i < points_.count; ++i)
            if (plane(WEIGHT)[i] > 0) seen.push_back(plane(RELATIVE)[i]);
        float median = 1;
        if (!seen.empty()) {
            const auto middle = seen.begin() + (seen.size() - 1) / 2;
            std::nth_element(seen.begin(), middle, seen.end());
            median = *middle;
        }
        const float per = 1 / (robust_scale * robust_scale * std::max(median, LEAST_RATIO));
        for (int64_t i = 0; i < points_.count; ++i) {
            const float one = 1 + plane(RELATIVE)[i] * per;
            plane(VOTE)[i] /= one * one;
        }
    }

    // The normal equations, less what offsets and gain of each patch would undo (variable projection).
    template <int UNKNOWNS> void normal_equations(float* hessian, float* gradient) {
        constexpr int ROWS = UNKNOWNS + 1;  // the residual is one more
        Lanes products[ROWS][ROWS] = {};
        float undone[ROWS][ROWS] = {};
        for (int64_t p = 0; p < points_.patches; ++p) {
            const int64_t first = points_.starts[p], end = points_.starts[p + 1];
            Lanes offsets[ROWS][4] = {}, total = {}, power = {};  // the last of each four: by the gain
            for (int64_t i = first; i < end; i += LANES) {
                Lanes weight = load(plane(VOTE) + i);
                for (int64_t k = end - i; k < LANES; ++k) weight[k] = 0;
                Lanes rows[ROWS][3], across[3], up[3], in_rig[3], shown[3];
                for (int k = 0; k < 3; ++k) {
                    across[k] = load(plane(ACROSS + k) + i), up[k] = load(plane(UP + k) + i);
                    in_rig[k] = load(plane(IN_RIG + k) + i), shown[k] = load(plane(SHOWN + k) + i);
                }
                for (int c = 0; c < 3; ++c) {
                    const Lanes by_azimuth = load(plane(BY_AZIMUTH + c) + i), by_elevation = load(plane(BY_ELEVATION + c) + i);
                    Lanes by_point[3];
                    for (int k = 0; k < 3; ++k) by_point[k] = by_azimuth * across[k] + by_elevation * up[k];
                    // A turn ω and a move τ of the rig take a point q of it to q − ω × q − τ.
                    for (int k = 0; k < 3; ++k) {
                        const int next = (k + 1) % 3, last = (k + 2) % 3;
                        rows[k][c] = by_point[next] * in_rig[last] - by_point[last] * in_rig[next];
                        rows[3 + k][c] = -by_point[k];
                    }
                    if constexpr (UNKNOWNS == 7)
                        rows[6][c] = by_azimuth * load(plane(FOCAL) + i) + by_elevation * load(plane(FOCAL_UP) + i);
                    rows[UNKNOWNS][c] = load(plane(RESIDUAL + c) + i);
                }
                for (int r = 0; r < ROWS; ++r) {
                    const Lanes weighted[3] = {weight * rows[r][0], weight * rows[r][1], weight * rows[r][2]};
                    for (int c = 0; c < 3; ++c) offsets[r][c] += weighted[c], offsets[r][3] += weighted[c] * shown[c];
                    for (int s = 0; s <= r; ++s)
                        products[r][s] += weighted[0] * rows[s][0] + weighted[1] * rows[s][1] + weighted[2] * rows[s][2];
                }
                total += weight;
                power += weight * (shown[0] * shown[0] + shown[1] * shown[1] + shown[2] * shown[2]);
            }
            const float per_total = 1 / std::sqrt(std::max(sum_of(total), 1e-9f));
            const float per_power = 1 / std::sqrt(std::max(sum_of(power), 1e-9f));
            float sums[ROWS][4];
            for (int r = 0; r < ROWS; ++r)
                for (int c = 0; c < 4; ++c) sums[r][c] = sum_of(offsets[r][c]) * (c < 3 ? per_total : per_power);
            for (int r = 0; r < ROWS; ++r)
                for (int s = 0; s <= r; ++s)
                    for (int c = 0; c < 4; ++c) undone[r][s] += sums[r][c] * sums[s][c];
        }
        for (int r = 0; r < UNKNOWNS; ++r) {
            for (int s = 0; s <= r; ++s)
                hessian[r * UNKNOWNS + s] = hessian[s * UNKNOWNS + r] = sum_of(products[r][s]) - undone[r][s];
            gradient[r] = sum_of(products[UNKNOWNS][r]) - undone[UNKNOWNS][r];
        }
        scale = std::sqrt(sum_of(products[UNKNOWNS][UNKNOWNS]) / mass);
    }

    float mass = 0, loss = 0, scale = 0;

  private:
    const Level& level_;
    const Points& points_;
    float* memory_;
    int64_t stride_;
};

}  // namespace
}  // namespace panoloc

// Take steps from K poses, none for their equations alone. Shapes: as of `Level`, `PointPlanes`, `PatchEquations` and `PoseStep`; poses are moved
// where they lie. starts: (patches + 1,), the first point of each patch. log_focals: null where focal lengths are those of the level.
extern "C" void pose_steps(const float* pixels, int64_t width, int64_t rows, const float* places, const float* camera_rotations,
    const float* centers, int64_t images, const float* positions, const float* colors, const float* weights, const int64_t* shown_by,
    const int64_t* starts, int64_t count, int64_t patches, int64_t candidates, float* rotations, float* at, float* log_focals,
    int64_t unknowns, float robust_scale, float noise, float damping, float lengthening, float max_step_m, float least_log_focal,
    float most_log_focal, int64_t steps, int64_t has_last, float* hessian, float* gradient, float* mass, float* loss,
    float* scale, float* step) {
    using namespace panoloc;
    const Level level{pixels, places, camera_rotations, centers, width, int(images), float(rows) / PI};
    const Rules rules{robust_scale, noise, damping, lengthening, max_step_m, least_log_focal, most_log_focal, has_last != 0};
    for_each(candidates, [&](int64_t k) {
        thread_local std::vector<float> memory;
        const Points points{positions + 3 * k * count, colors + 3 * k * count, weights + k * count,
            shown_by ? shown_by + k * count : nullptr, starts, count, patches};
        float *rotation = rotations + 9 * k, *position = at + 3 * k, *log_focal = log_focals ? log_focals + k : nullptr;
        for (int64_t done = 0; done < std::max<int64_t>(1, steps); ++done) {
            Equations equations(level, points, memory);
            const float factor = log_focal ? std::exp(*log_focal) : 1;
            if (shown_by) equations.project<false>(rotation, position, factor);
            else equations.project<true>(rotation, position, factor);
            equations.sample();
            equations.compare(rules.noise);
            if (rules.robust_scale > 0) equations.weigh_robustly(rules.robust_scale);
            float *h = hessian + unknowns * unknowns * k, *g = gradient + unknowns * k, *moved = step + unknowns * k;
            if (unknowns == 7) equations.normal_equations<7>(h, g);
            else equations.normal_equations<6>(h, g);
            mass[k] = equations.mass, loss[k] = equations.loss, scale[k] = equations.scale;
            if (steps == 0) break;
            const bool is_last = rules.has_last && done + 1 == steps;
            if (unknowns == 7) move<7>(h, g, rules, is_last, rotation, position, log_focal, moved);
            else move<6>(h, g, rules, is_last, rotation, position, log_focal, moved);
        }
    });
}
