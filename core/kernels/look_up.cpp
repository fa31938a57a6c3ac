// What images show at the rendered pixels of views: what `RigView` of panoloc.core.render.comparison says in tensors.

#include "kernels.h"

// Directions (S, 3) of pixels in the axes of the rig; depth (K, S) metres and valid (K, S) of K views. Each pixel is looked up in the image whose
// middle is nearest, of those whose cones of `cosines` (M,) it lies in. color (K, S, 3), zero and image −1 where none shows it.
extern "C" void look_up(const float* pixels, int64_t width, int64_t rows, const float* places, const float* camera_rotations,
    const float* centers, int64_t images, const float* directions, int64_t size, const float* depth, const uint8_t* valid, int64_t views,
    const float* cosines, const float* log_focals, float* color, int64_t* image) {
    using namespace panoloc;
    constexpr int64_t PART = 256;
    constexpr float FARTHEST_M = 1e6f;
    // Where holes were filled nothing is known of depth: an only image shows the same there whatever it is, several show nothing.
    const float without_depth = images == 1 ? 1 : std::numeric_limits<float>::quiet_NaN();
    const int64_t parts = (size + PART - 1) / PART;
    for_each(views * parts, [&](int64_t number) {
        const int64_t k = number / parts, first = number % parts * PART, count = std::min(PART, size - first), start = k * size + first;
        const float factor = log_focals ? std::exp(log_focals[k]) : 1, *d = directions + 3 * first, *far = depth + start;
        float columns[PART], lines[PART], aheads[PART], best[PART];
        std::fill_n(best, PART, -2.0f);
        std::fill_n(color + 3 * start, 3 * count, 0.0f);
        std::fill_n(image + start, count, -1);
        for (int64_t m = 0; m < images; ++m) {
            float c[9], t[3];
            std::copy_n(camera_rotations + 9 * m, 9, c), std::copy_n(centers + 3 * m, 3, t);
            const float first_column = places[m], first_row = places[images + m], last_column = places[2 * images + m];
            const float last_row = places[3 * images + m], above = places[4 * images + m] + 1, cosine = cosines[m];
            const float per_rad = float(rows) / PI, unknown = without_depth;
            bool is_any_near = false;
            for (int64_t i = 0; i < count; ++i) is_any_near |= d[3 * i] * c[0] + d[3 * i + 1] * c[3] + d[3 * i + 2] * c[6] >= cosine;
            if (!is_any_near) continue;
#pragma GCC ivdep
            for (int64_t i = 0; i < count; ++i) {
                const float dx = d[3 * i], dy = d[3 * i + 1], dz = d[3 * i + 2], distance = far[i] < FARTHEST_M ? far[i] : unknown;
                const float rx = dx * distance - t[0], ry = dy * distance - t[1], rz = dz * distance - t[2];
                const float x = c[0] * rx + c[3] * ry + c[6] * rz;
                const float y = factor * (c[1] * rx + c[4] * ry + c[7] * rz), z = factor * (c[2] * rx + c[5] * ry + c[8] * rz);
                const float flat = std::sqrt(x * x + y * y), length = std::sqrt(flat * flat + z * z);
                const float column = (PI - angle_of(y, x)) * per_rad - first_column, row = (PI / 2 - angle_of(z, flat)) * per_rad - first_row;
                // What is no number becomes 0.
                columns[i] = (column > 0 ? column < last_column ? column : last_column : 0) + 1;
                lines[i] = (row > 0 ? row < last_row ? row : last_row : 0) + above;
                aheads[i] = dx * c[0] + dy * c[3] + dz * c[6] >= cosine ? x / (length > 1e-6f ? length : 1e-6f) : -3;
            }
            for (int64_t i = 0; i < count; ++i) {
                if (!(aheads[i] > best[i]) || !valid[start + i]) continue;
                const float left = std::floor(columns[i]), top = std::floor(lines[i]), u = columns[i] - left, v = lines[i] - top;
                const float* at = pixels + (int64_t(top) * width + int64_t(left)) * 4;
                const Pixel upper = (1 - u) * pixel_at(at) + u * pixel_at(at + 4);
                const Pixel lower = (1 - u) * pixel_at(at + 4 * width) + u * pixel_at(at + 4 * width + 4);
                const Pixel shown = (1 - v) * upper + v * lower;
                if (shown[3] <= VALID_SHARE) continue;
                best[i] = aheads[i], image[start + i] = m;
                for (int channel = 0; channel < 3; ++channel) color[3 * (start + i) + channel] = shown[channel];
            }
        }
    });
}
