// What kernel.cu needs of CUDA, for a C++ compiler on Linux: the threads of a block are fibers of
// one thread, which take turns where they wait for one another.
//
// A block runs after the other, so __shared__ variables are static ones. A fiber goes on until it
// waits: in a shuffle or a vote for the other lanes of its warp, in __syncthreads for the block. All
// lanes of a warp take part in each shuffle (the mask is ALL everywhere), so one that lanes leave out
// never ends here either: `run` gives up.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <vector>

#include <ucontext.h>

#define __device__
#define __global__
#define __shared__ static
#define __forceinline__ inline
#define __launch_bounds__(...)

struct alignas(8) float2 {
  float x, y;
};
struct alignas(16) float4 {
  float x, y, z, w;
};
struct Index {
  int x;
};

// ---------------------------------------------------------------- fibers

struct Fiber {
  ucontext_t context;
  std::vector<char> stack = std::vector<char>(1 << 16);
  int thread;
  bool done;
};

struct Barrier {
  int size, arrived;
  long turn;
};

const int WARP = 32, MOST_WARPS = 32;
static std::vector<Fiber> fibers;
static Fiber *current;
static ucontext_t scheduler;
static Barrier of_warp[MOST_WARPS], of_block;
static const std::function<void()> *running;
static Index blockIdx, blockDim;
#define threadIdx (Index{current->thread})

static void wait(Barrier &barrier) {
  const long turn = barrier.turn;
  if (++barrier.arrived == barrier.size) {
    barrier.arrived = 0;
    barrier.turn++;
  }
  while (barrier.turn == turn) swapcontext(&current->context, &scheduler);
}

static void begin() {
  (*running)();
  current->done = true;
}

// Run a kernel. Returns false where fibers wait for ever.
static bool run(int blocks, int threads, const std::function<void()> &kernel) {
  running = &kernel;
  blockDim.x = threads;
  if ((int)fibers.size() < threads) fibers.resize(threads);
  for (int block = 0; block < blocks; block++) {
    blockIdx.x = block;
    of_block = {threads, 0, 0};
    for (int w = 0; w * WARP < threads; w++) of_warp[w] = {std::min(WARP, threads - w * WARP), 0, 0};
    for (int i = 0; i < threads; i++) {
      Fiber &fiber = fibers[i];
      fiber.thread = i;
      fiber.done = false;
      getcontext(&fiber.context);
      fiber.context.uc_stack.ss_sp = fiber.stack.data();
      fiber.context.uc_stack.ss_size = fiber.stack.size();
      fiber.context.uc_link = &scheduler;
      makecontext(&fiber.context, begin, 0);
    }
    long before = -1;
    for (int left = threads; left;) {
      for (int i = 0; i < threads; i++) {
        if (fibers[i].done) continue;
        current = &fibers[i];
        swapcontext(&scheduler, &current->context);
        left -= current->done;
      }
      long moved = of_block.turn + of_block.arrived - left;
      for (int w = 0; w * WARP < threads; w++) moved += of_warp[w].turn + of_warp[w].arrived;
      // No fiber ended or arrived anywhere while each had its turn.
      if (moved == before) return false;
      before = moved;
    }
  }
  return true;
}

// ---------------------------------------------------------------- lanes of a warp

static uint64_t given[MOST_WARPS][2][WARP];

// What the lanes of this warp give, after all have. Two places in turn: a fast lane may give its
// next value while a slow one still reads.
template <class T>
static const uint64_t *gathered(T value) {
  static_assert(sizeof(T) <= sizeof(uint64_t), "a lane gives at most eight bytes");
  const int warp = current->thread / WARP;
  uint64_t *place = given[warp][of_warp[warp].turn % 2];
  place[current->thread % WARP] = 0;
  memcpy(&place[current->thread % WARP], &value, sizeof(T));
  wait(of_warp[warp]);
  return place;
}

template <class T>
static T taken(const uint64_t *place, int lane) {
  T value;
  memcpy(&value, &place[lane], sizeof(T));
  return value;
}

template <class T>
static T __shfl_sync(unsigned, T value, int lane) {
  return taken<T>(gathered(value), lane % WARP);
}
template <class T>
static T __shfl_xor_sync(unsigned, T value, int mask) {
  return taken<T>(gathered(value), (current->thread % WARP) ^ mask);
}
template <class T>
static T __shfl_up_sync(unsigned, T value, int distance) {
  const int lane = current->thread % WARP;
  return taken<T>(gathered(value), lane < distance ? lane : lane - distance);
}
static unsigned __ballot_sync(unsigned, bool vote) {
  const uint64_t *place = gathered((int)vote);
  unsigned votes = 0;
  for (int lane = 0; lane < WARP; lane++) votes |= (unsigned)taken<int>(place, lane) << lane;
  return votes;
}
static bool __any_sync(unsigned mask, bool vote) { return __ballot_sync(mask, vote); }
static bool __all_sync(unsigned mask, bool vote) { return !__ballot_sync(mask, !vote); }
static void __syncwarp() { gathered(0); }
static void __syncthreads() { wait(of_block); }

// ---------------------------------------------------------------- numbers

template <class To, class From>
static To same_bits(From value) {
  To bits;
  memcpy(&bits, &value, sizeof(To));
  return bits;
}
static float __int_as_float(int x) { return same_bits<float>(x); }
static float __uint_as_float(unsigned x) { return same_bits<float>(x); }
static int __float_as_int(float x) { return same_bits<int>(x); }
static unsigned __float_as_uint(float x) { return same_bits<unsigned>(x); }
static int __popc(unsigned x) { return __builtin_popcount(x); }
static int __ffs(unsigned x) { return __builtin_ffs((int)x); }
static int __clz(unsigned x) { return x ? __builtin_clz(x) : 32; }
static float rsqrtf(float x) { return 1 / sqrtf(x); }
static int min(int a, int b) { return std::min(a, b); }
static int max(int a, int b) { return std::max(a, b); }
static unsigned min(unsigned a, unsigned b) { return std::min(a, b); }
static unsigned max(unsigned a, unsigned b) { return std::max(a, b); }

// Fibers are interrupted only where they wait.
template <class T, class U>
static T atomicAdd(T *place, U value) {
  const T before = *place;
  *place += value;
  return before;
}
template <class T>
static T atomicMin(T *place, T value) {
  const T before = *place;
  *place = std::min(before, value);
  return before;
}
template <class T>
static T atomicMax(T *place, T value) {
  const T before = *place;
  *place = std::max(before, value);
  return before;
}
