// Products of plane samples on a CUDA device. plane_kernel.py fills in the capitals:
//
// SIDE      knots of a line, and of each side of a plane     CHANNELS  channels of a knot
// MOVES     1 if the gradient of positions is wanted         SHARED    1 if a block sums lines itself
//
// The number of Gaussians differs from call to call: it is put into the PTX, so that another one
// does not have to be compiled.

__device__ __forceinline__ int gaussians() {
  int n;
  asm("mov.u32 %0, NUMBER_OF_GAUSSIANS;" : "=r"(n));
  return n;
}

// Channels of a thread.
#define OWN (CHANNELS % 4 ? 1 : 4)
#define PARTS (CHANNELS / OWN)
#define LINES (3 * SIDE * CHANNELS)

struct Channels {
  float x[OWN];
};

__device__ __forceinline__ Channels read(const float* p) {
  Channels c;
#if CHANNELS % 4 == 0
  float4 v = *reinterpret_cast<const float4*>(p);
  c.x[0] = v.x, c.x[1] = v.y, c.x[2] = v.z, c.x[3] = v.w;
#else
  c.x[0] = *p;
#endif
  return c;
}

__device__ __forceinline__ void write(float* p, Channels c) {
#if CHANNELS % 4 == 0
  *reinterpret_cast<float4*>(p) = make_float4(c.x[0], c.x[1], c.x[2], c.x[3]);
#else
  *p = c.x[0];
#endif
}

// Adds w c to what stands in global memory.
__device__ __forceinline__ void add(float* p, float w, Channels c) {
#if CHANNELS % 4 == 0 && __CUDA_ARCH__ >= 900
  asm volatile("red.global.add.v4.f32 [%0], {%1, %2, %3, %4};" ::"l"(__cvta_generic_to_global(p)),
               "f"(w * c.x[0]), "f"(w * c.x[1]), "f"(w * c.x[2]), "f"(w * c.x[3])
               : "memory");
#else
#pragma unroll
  for (int k = 0; k < OWN; k++) atomicAdd(p + k, w * c.x[k]);
#endif
}

struct Knot {
  int low;
  float right;
};

__device__ __forceinline__ Knot knot(float x) {
  float place = x * (SIDE - 1);
  // What is not a number becomes a knot, too.
  int low = min(max((int)place, 0), SIDE - 2);
  return {low, place - low};
}

// The samples of a Gaussian: first those of three planes, then those of three lines.
struct Samples {
  Knot at[3];
  int corner[3], start[3];
  Channels value[6];
};

// Axes of the planes xy, xz and yz.
#define FIRST(plane) ((plane) < 2 ? 0 : 1)
#define SECOND(plane) ((plane) < 1 ? 1 : 2)
#define DOWN (SIDE * CHANNELS)

__device__ __forceinline__ Samples samples(const float* space, const float* line, const float* unit,
                                           int i, int channel) {
  Samples s;
#pragma unroll
  for (int axis = 0; axis < 3; axis++) {
    Knot k = s.at[axis] = knot(unit[3 * i + axis]);
    int at = s.start[axis] = (axis * SIDE + k.low) * CHANNELS + channel;
    Channels a = read(line + at), b = read(line + at + CHANNELS);
#pragma unroll
    for (int c = 0; c < OWN; c++)
      s.value[3 + axis].x[c] = (1 - k.right) * a.x[c] + k.right * b.x[c];
  }
#pragma unroll
  for (int plane = 0; plane < 3; plane++) {
    Knot column = s.at[FIRST(plane)], row = s.at[SECOND(plane)];
    int at = ((plane * SIDE + row.low) * SIDE + column.low) * CHANNELS + channel;
    s.corner[plane] = at;
    Channels a = read(space + at), b = read(space + at + CHANNELS);
    Channels c = read(space + at + DOWN), d = read(space + at + DOWN + CHANNELS);
#pragma unroll
    for (int k = 0; k < OWN; k++) {
      float top = (1 - column.right) * a.x[k] + column.right * b.x[k];
      float bottom = (1 - column.right) * c.x[k] + column.right * d.x[k];
      s.value[plane].x[k] = (1 - row.right) * top + row.right * bottom;
    }
  }
  return s;
}

extern "C" __global__ void forward(const float* space, const float* line, const float* unit,
                                   float* out) {
  int job = blockIdx.x * blockDim.x + threadIdx.x;
  int i = job / PARTS, channel = job % PARTS * OWN;
  if (i >= gaussians()) return;
  Samples s = samples(space, line, unit, i, channel);
  Channels product = s.value[0];
#pragma unroll
  for (int v = 1; v < 6; v++)
#pragma unroll
    for (int c = 0; c < OWN; c++) product.x[c] *= s.value[v].x[c];
  write(out + (size_t)i * CHANNELS + channel, product);
}

// Adds the gradient of a sample of a plane to its corners.
__device__ __forceinline__ void add_corners(float* d_space, int at, Knot column, Knot row,
                                            Channels d) {
  float left = 1 - column.right, up = 1 - row.right;
  add(d_space + at, left * up, d);
  add(d_space + at + CHANNELS, column.right * up, d);
  add(d_space + at + DOWN, left * row.right, d);
  add(d_space + at + DOWN + CHANNELS, column.right * row.right, d);
}

// Adds the gradients of the positions within the cells.
__device__ __forceinline__ void add_position(const float* space, const float* line, const Samples& s,
                                             const Channels* d, float* d_unit) {
  float slope[3] = {0, 0, 0};
#pragma unroll
  for (int axis = 0; axis < 3; axis++) {
    Channels a = read(line + s.start[axis]), b = read(line + s.start[axis] + CHANNELS);
#pragma unroll
    for (int k = 0; k < OWN; k++) slope[axis] += d[3 + axis].x[k] * (b.x[k] - a.x[k]);
  }
#pragma unroll
  for (int plane = 0; plane < 3; plane++) {
    float right = s.at[FIRST(plane)].right, down = s.at[SECOND(plane)].right;
    const float* p = space + s.corner[plane];
    Channels a = read(p), b = read(p + CHANNELS), c = read(p + DOWN), e = read(p + DOWN + CHANNELS);
#pragma unroll
    for (int k = 0; k < OWN; k++) {
      float g = d[plane].x[k];
      slope[FIRST(plane)] += g * ((1 - down) * (b.x[k] - a.x[k]) + down * (e.x[k] - c.x[k]));
      slope[SECOND(plane)] += g * ((1 - right) * (c.x[k] - a.x[k]) + right * (e.x[k] - b.x[k]));
    }
  }
#pragma unroll
  for (int axis = 0; axis < 3; axis++) atomicAdd(d_unit + axis, (SIDE - 1) * slope[axis]);
}

extern "C" __global__ void backward(const float* space, const float* line, const float* unit,
                                    const float* g, float* d_space, float* d_line, float* d_unit) {
#if SHARED
  __shared__ float own_line[LINES];
  for (int k = threadIdx.x; k < LINES; k += blockDim.x) own_line[k] = 0;
  __syncthreads();
#endif
  int jobs = gaussians() * PARTS;
  for (int job = blockIdx.x * blockDim.x + threadIdx.x; job < jobs; job += gridDim.x * blockDim.x) {
    int i = job / PARTS, channel = job % PARTS * OWN;
    Samples s = samples(space, line, unit, i, channel);
    Channels product = read(g + (size_t)i * CHANNELS + channel), d[6];
    // Products of what stands before each sample, then times what stands behind it.
#pragma unroll
    for (int v = 0; v < 6; v++) {
      d[v] = product;
#pragma unroll
      for (int c = 0; c < OWN; c++) product.x[c] *= s.value[v].x[c];
    }
    Channels behind = s.value[5];
#pragma unroll
    for (int v = 4; v >= 0; v--)
#pragma unroll
      for (int c = 0; c < OWN; c++) {
        d[v].x[c] *= behind.x[c];
        behind.x[c] *= s.value[v].x[c];
      }
#pragma unroll
    for (int plane = 0; plane < 3; plane++)
      add_corners(d_space, s.corner[plane], s.at[FIRST(plane)], s.at[SECOND(plane)], d[plane]);
#pragma unroll
    for (int axis = 0; axis < 3; axis++) {
      float right = s.at[axis].right;
#if SHARED
#pragma unroll
      for (int c = 0; c < OWN; c++) {
        atomicAdd(own_line + s.start[axis] + c, (1 - right) * d[3 + axis].x[c]);
        atomicAdd(own_line + s.start[axis] + CHANNELS + c, right * d[3 + axis].x[c]);
      }
#else
      add(d_line + s.start[axis], 1 - right, d[3 + axis]);
      add(d_line + s.start[axis] + CHANNELS, right, d[3 + axis]);
#endif
    }
#if MOVES
    add_position(space, line, s, d, d_unit + 3 * (size_t)i);
#endif
  }
#if SHARED
  __syncthreads();
  for (int k = threadIdx.x; k < LINES; k += blockDim.x)
    if (own_line[k] != 0) atomicAdd(d_line + k, own_line[k]);
#endif
}
