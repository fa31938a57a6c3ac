// CUDA C++ as a compiler for processors takes it: one block after the other, each of one thread, which is a warp.
#pragma once

#include <atomic>
#include <cmath>
#include <cstring>

#define WARP 1
#define __global__
#define __device__
#define __shared__ static
#define __launch_bounds__(threads)

struct Index { int x; };
struct Float4 { float x, y, z, w; };
static Index blockIdx{0}, threadIdx{0}, blockDim{1};

inline void __syncthreads() {}
inline void __syncwarp() {}
inline float __shfl_xor_sync(unsigned, float value, int) { return value; }
inline unsigned __shfl_sync(unsigned, unsigned value, int) { return value; }
inline float rsqrtf(float value) { return 1 / std::sqrt(value); }
inline unsigned atomicAdd(unsigned* to, unsigned value) { return *to += value, *to - value; }
inline unsigned __float_as_uint(float value) { unsigned bits; std::memcpy(&bits, &value, 4); return bits; }
inline float __uint_as_float(unsigned bits) { float value; std::memcpy(&value, &bits, 4); return value; }

extern "C" void set_block(int number) { blockIdx.x = number; }
