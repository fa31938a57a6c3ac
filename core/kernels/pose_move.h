// How a step moves a pose: the same on processors and on GPUs, in double precision, of which there is little to do.
#pragma once

#ifdef __CUDACC__
#define EVERYWHERE __device__ __noinline__
#define UNROLLED _Pragma("unroll")
#else
#define UNROLLED _Pragma("GCC unroll 8")
#include <cmath>
#define EVERYWHERE inline
#endif

namespace panoloc {

// How a pose is moved; see `StepConfig`. The last of all steps is not lengthened. A focal length is unknown within its bounds.
struct Rules {
    float robust_scale, noise, damping, lengthening, max_step_m, least_log_focal, most_log_focal;
    bool has_last;
};

constexpr double METRES = 1.5;

EVERYWHERE double larger(double a, double b) { return a < b ? b : a; }

EVERYWHERE double length_of(const float* vector) {
    return sqrt(double(vector[0]) * vector[0] + double(vector[1]) * vector[1] + double(vector[2]) * vector[2]);
}

// The solution of n equations that are symmetric and positive definite, as damped ones are (LDLᵀ); `rows` and `right` are used up.
template <int N> EVERYWHERE void solve(double (&rows)[N][N], double (&right)[N]) {
    // Of constant length, so that all of it stays in registers.
    UNROLLED
    for (int k = 0; k < N; ++k) {
        const double per = 1 / rows[k][k];
        UNROLLED
        for (int r = k + 1; r < N; ++r) {
            const double times = rows[r][k] * per;
            UNROLLED
            for (int c = k + 1; c <= r; ++c) rows[r][c] -= times * rows[c][k];
            right[r] -= times * right[k];
        }
        right[k] *= per;
        UNROLLED
        for (int r = k + 1; r < N; ++r) rows[r][k] *= per;
    }
    UNROLLED
    for (int k = N - 1; k >= 0; --k)
        UNROLLED
        for (int r = k + 1; r < N; ++r) right[k] -= rows[r][k] * right[r];
}

// Turn a rotation (3, 3) by a rotation vector in its own frame (Rodrigues).
EVERYWHERE void turn_by(const float* vector, float* rotation) {
    const double x = vector[0], y = vector[1], z = vector[2], angle = length_of(vector);
    const double first = angle > 1e-8 ? sin(angle) / angle : 1, half = angle > 1e-8 ? sin(angle / 2) / angle : 0.5;
    const double second = 2 * half * half, cross[3][3] = {{0, -z, y}, {z, 0, -x}, {-y, x, 0}};
    double turn[3][3];
    for (int r = 0; r < 3; ++r)
        for (int c = 0; c < 3; ++c) {
            turn[r][c] = (r == c) + first * cross[r][c];
            for (int k = 0; k < 3; ++k) turn[r][c] += second * cross[r][k] * cross[k][c];
        }
    for (int r = 0; r < 3; ++r) {
        const double old[3] = {rotation[3 * r], rotation[3 * r + 1], rotation[3 * r + 2]};
        for (int c = 0; c < 3; ++c) rotation[3 * r + c] = float(old[0] * turn[0][c] + old[1] * turn[1][c] + old[2] * turn[2][c]);
    }
}

// Move a pose by the solution of the damped equations: turn (rad), move (m) and, where it is unknown, logarithm of the focal length.
template <int UNKNOWNS>
EVERYWHERE void move(const float* hessian, const float* gradient, const Rules& rules, bool is_last, float* rotation, float* position,
    float* log_focal, float* step) {
    double rows[UNKNOWNS][UNKNOWNS], right[UNKNOWNS];
    for (int r = 0; r < UNKNOWNS; ++r) {
        right[r] = gradient[r];
        for (int c = 0; c < UNKNOWNS; ++c) rows[r][c] = hessian[UNKNOWNS * r + c];
    }
    // A focal length at a bound, beyond which the loss falls, is no unknown: the pose must not follow it.
    if (UNKNOWNS == 7
        && ((*log_focal <= rules.least_log_focal && right[6] > 0) || (*log_focal >= rules.most_log_focal && right[6] < 0))) {
        for (int k = 0; k < UNKNOWNS; ++k) rows[UNKNOWNS - 1][k] = rows[k][UNKNOWNS - 1] = 0;
        right[UNKNOWNS - 1] = 0;
    }
    for (int k = 0; k < UNKNOWNS; ++k) rows[k][k] += rows[k][k] * rules.damping + 1e-6;
    solve(rows, right);
    for (int k = 0; k < UNKNOWNS; ++k) step[k] = float(-(is_last ? 1 : rules.lengthening) * right[k]);
    // As a whole: a part of it alone would leave the valley that pose and focal length share.
    const double spread = UNKNOWNS == 7 ? METRES * fabs(step[UNKNOWNS - 1]) : 0;
    const double longest = larger(larger(METRES * length_of(step), length_of(step + 3)), spread) / rules.max_step_m;
    for (int k = 0; k < UNKNOWNS; ++k) step[k] = float(step[k] / larger(longest, 1));
    for (int r = 0; r < 3; ++r)
        position[r] += rotation[3 * r] * step[3] + rotation[3 * r + 1] * step[4] + rotation[3 * r + 2] * step[5];
    turn_by(step, rotation);
    if (UNKNOWNS == 7) {
        const float reached = *log_focal + step[UNKNOWNS - 1];
        *log_focal = float(larger(rules.least_log_focal, reached < rules.most_log_focal ? reached : rules.most_log_focal));
    }
}

}  // namespace panoloc
