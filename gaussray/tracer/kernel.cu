// Candidates to pixels on a CUDA device. kernel.py explains the algorithm and fills in the capitals:
//
// RAYS     rays of one sample, a multiple of GROUP      SAMPLES  samples of every ray
// GROUP    consecutive rays that share a list           SIDE     rays in the first row of a bundle
// SLOTS    entries that a list holds                    SUPERS   boxes of 256 Gaussians
// KEYS     control points of the moving Gaussians       HARMONICS coefficients per channel
// TINTED   1 if colours are tinted                      COLUMNS  floats in a row of colour
// K        hits that a lane keeps in order              WARPS    of a block of the march
// LANES    lanes that share a ray                       BROAD    pixels in a row of a warp, or 0
// ACROSS   bundles of a group side by side              TRANSIENT 1 if Gaussians are transient
// TEAM     threads of a block of `gather`
// ALPHA_MAX, TRANSMITTANCE_MIN as in TraceOptions
//
// RAYS, SLOTS and SUPERS differ from call to call. `Program.code` puts their numbers into the PTX, so
// that other numbers do not have to be compiled.

typedef unsigned int u32;

#define NUMBER(NAME)                                 \
  __device__ __forceinline__ int number_of_##NAME() { \
    int n;                                           \
    asm("mov.u32 %0, NUMBER_OF_" #NAME ";" : "=r"(n)); \
    return n;                                        \
  }
NUMBER(RAYS)
NUMBER(SLOTS)
NUMBER(SUPERS)
#define RAYS number_of_RAYS()
#define SLOTS number_of_SLOTS()
#define SUPERS number_of_SUPERS()

#define ALL 0xffffffffu
#define INFINITE __int_as_float(0x7f800000)
#define EPSILON 1.1920929e-7f
#define SLACK (16 * EPSILON)
// By so much of an ellipsoid's height the peaks that rays compute may be nearer than its least one:
// they are rounded, most of all along thin discs.
#define PEAK_SLACK 1e-3f
// Below this cosine to the axis a bundle is too wide for planes: it is then tested as everywhere.
#define WIDEST 0.05f
#define BUCKETS 1024
// Buckets of a thread of `gather`.
#define OWN (BUCKETS / TEAM)
// Rays of a warp, warps of a group, and parts of a group: one warp each, or several where a group
// has more than 32. For each part a bit says whether it may meet an entry.
#define WIDE (32 / LANES)
#define PER ((GROUP + WIDE - 1) / WIDE)
#define SPAN ((PER + 31) / 32)
#define PARTS ((PER + SPAN - 1) / SPAN)
#define WORDS ((SLOTS + 31) / 32)
#define JOBS ((size_t)(RAYS / GROUP) * SAMPLES * PER)
#define ARCS (KEYS < 3 ? 1 : (KEYS - 1) / 2)
// Where a group is a square of 8 x 8 pixels or of 2 x 2 times as many, parts are where columns and
// rows of pixels cross, and those bands are what is tested. Of other groups every part is tested for
// itself, as a row.
#define SQUARE (BROAD > 0)
#define HIGH (8 / (SQUARE ? BROAD : 8))
#define COLUMNS_OF_PARTS (SQUARE ? 8 * ACROSS / (SQUARE ? BROAD : 8) : 0)
#define ROWS_OF_PARTS (SQUARE ? 8 * ACROSS / HIGH : PARTS)
#define BANDS (COLUMNS_OF_PARTS + ROWS_OF_PARTS)

struct Vector {
  float x, y, z;
};

__device__ __forceinline__ Vector operator+(Vector a, Vector b) {
  return {a.x + b.x, a.y + b.y, a.z + b.z};
}
__device__ __forceinline__ Vector operator-(Vector a, Vector b) {
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}
__device__ __forceinline__ Vector operator*(float s, Vector a) {
  return {s * a.x, s * a.y, s * a.z};
}
__device__ __forceinline__ float dot(Vector a, Vector b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}
__device__ __forceinline__ Vector cross(Vector a, Vector b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
__device__ __forceinline__ Vector normalize(Vector a) {
  float square = dot(a, a);
  return square > 0 ? rsqrtf(square) * a : a;
}
__device__ __forceinline__ Vector load(const float *p, size_t i) {
  return {p[3 * i], p[3 * i + 1], p[3 * i + 2]};
}
__device__ __forceinline__ void store(float *p, size_t i, Vector v) {
  p[3 * i] = v.x;
  p[3 * i + 1] = v.y;
  p[3 * i + 2] = v.z;
}
__device__ __forceinline__ bool finite(Vector v) {
  return fabsf(v.x) < INFINITE && fabsf(v.y) < INFINITE && fabsf(v.z) < INFINITE;
}

// ---------------------------------------------------------------- bounds of a group of rays

// Half-spaces n.x >= offset that hold all rays: near plane, four sides. `reach` is the largest
// n.origin of the near plane, infinity if distances are not bounded. `begin` and `end` are where on
// the arcs of the motion the group's times lie: the number of an arc, and the fraction of it.
// `cosine` is the least one between a ray and the normal of the near plane.
struct Bounds {
  float4 plane[5];
  float reach, begin, end, cosine;
#if TRANSIENT
  // The earliest and the latest time of the group.
  float earliest, latest, more[2];
#endif
};

// Rays that begin at one place (`one`): along axis + x u + y v, x from left to right, y from down to
// up.
struct Fan {
  Vector origin, axis, u, v;
  float left, right, down, up;
  bool one;
};

// Which ray of a group is at a pixel, in column x and row y of the group.
__device__ __forceinline__ int slot_at(int x, int y) {
  return 64 * (x / 8 + ACROSS * (y / 8)) + 8 * (y % 8) + x % 8;
}

// In which column and row of parts a part is.
__device__ __forceinline__ int column_of(int part) {
  return part / 8 % ACROSS * HIGH + part % HIGH;
}
__device__ __forceinline__ int row_of(int part) {
  return SQUARE ? part / 8 / ACROSS * (8 / HIGH) + part % 8 / HIGH : part;
}

// Which ray of a group is number `i` of a warp's.
__device__ __forceinline__ int slot_of(int warp, int i) {
  if (!SQUARE) return WIDE * warp + i;
  return slot_at(BROAD * column_of(warp) + i % BROAD, HIGH * row_of(warp) + i / BROAD);
}

// How many rays a band has, and which ray of its group is number `i`.
__device__ __forceinline__ int rays_in(int band) {
  if (!SQUARE) return min(WIDE * SPAN, GROUP - WIDE * SPAN * band);
  return 8 * ACROSS * (band < COLUMNS_OF_PARTS ? BROAD : HIGH);
}
__device__ __forceinline__ int slot_in(int band, int i) {
  if (!SQUARE) return WIDE * SPAN * band + i;
  if (band < COLUMNS_OF_PARTS) return slot_at(BROAD * band + i % BROAD, i / BROAD);
  const int wide = 8 * ACROSS;
  return slot_at(i % wide, HIGH * (band - COLUMNS_OF_PARTS) + i / wide);
}

// Where on the arcs a ray's weights are.
__device__ __forceinline__ float position(float4 weight) {
  return KEYS == 2 ? weight.y : 0.5f * weight.w + weight.z + 0.5f * weight.y;
}

__device__ __forceinline__ int least_of_warp(int v) {
  for (int i = 16; i; i >>= 1) v = min(v, __shfl_xor_sync(ALL, v, i));
  return v;
}

struct Warp {
  __device__ int rank() { return threadIdx.x & 31; }
  __device__ int size() { return 32; }
  __device__ float minimum(float v) {
    for (int i = 16; i; i >>= 1) v = fminf(v, __shfl_xor_sync(ALL, v, i));
    return v;
  }
  __device__ float sum(float v) {
    for (int i = 16; i; i >>= 1) v += __shfl_xor_sync(ALL, v, i);
    return v;
  }
};

// As many lanes as a warp of the march has rays: a warp of these bounds several of those.
struct Lanes {
  __device__ int rank() { return threadIdx.x % WIDE; }
  __device__ int size() { return WIDE; }
  __device__ float minimum(float v) {
    for (int i = WIDE / 2; i; i >>= 1) v = fminf(v, __shfl_xor_sync(ALL, v, i));
    return v;
  }
  __device__ float sum(float v) {
    for (int i = WIDE / 2; i; i >>= 1) v += __shfl_xor_sync(ALL, v, i);
    return v;
  }
};

struct Block {
  float *scratch;
  __device__ int rank() { return threadIdx.x; }
  __device__ int size() { return blockDim.x; }
  __device__ float minimum(float v) {
    v = Warp().minimum(v);
    share(v);
    float least = scratch[0];
    for (int i = 1; i < blockDim.x / 32; i++) least = fminf(least, scratch[i]);
    return least;
  }
  __device__ float sum(float v) {
    v = Warp().sum(v);
    share(v);
    float total = scratch[0];
    for (int i = 1; i < blockDim.x / 32; i++) total += scratch[i];
    return total;
  }
  __device__ void share(float v) {
    __syncthreads();
    if (!(threadIdx.x & 31)) scratch[threadIdx.x >> 5] = v;
    __syncthreads();
  }
};

template <class Team>
__device__ Vector sum(Team team, Vector v) {
  return {team.sum(v.x), team.sum(v.y), team.sum(v.z)};
}

// Of a group that begins with ray `begin`, the `count` rays `slot(0)`, `slot(1)`, ... in so many
// `samples`, seen by a team of threads; also as a fan, where one is asked for.
template <class Team, class Slot>
__device__ Bounds bound(Team team, const float *origin, const float *direction,
                        const float4 *weight, const float *time, size_t begin, int samples,
                        int count, Slot slot, Fan *fan) {
  auto each = [&](auto visit) {
    for (int i = team.rank(); i < count * samples; i += team.size()) {
      size_t ray = begin + (size_t)(i / count) * RAYS + slot(i % count);
      Vector o = load(origin, ray), d = load(direction, ray);
      bool real = finite(o) && finite(d) && (d.x != 0 || d.y != 0 || d.z != 0);
      if (real) visit(ray, o, d);
    }
  };
  Bounds b;
  Vector total = {0, 0, 0};
  float magnitude = 0, first = INFINITE, last = -INFINITE;
  float earliest = INFINITE, latest = -INFINITE;
  each([&](size_t ray, Vector o, Vector d) {
    total = total + d;
    magnitude = fmaxf(magnitude, fmaxf(fabsf(o.x), fmaxf(fabsf(o.y), fabsf(o.z))));
    if (KEYS > 1) {
      float at = position(weight[ray]);
      first = fminf(first, at);
      last = fmaxf(last, at);
    }
    if (TRANSIENT) {
      earliest = fminf(earliest, time[ray]);
      latest = fmaxf(latest, time[ray]);
    }
  });
#if TRANSIENT
  b.earliest = team.minimum(earliest);
  b.latest = -team.minimum(-latest);
#endif
  magnitude = -team.minimum(-magnitude);
  b.begin = KEYS > 1 ? fmaxf(team.minimum(first) - SLACK * ARCS, 0) : 0;
  b.end = KEYS > 1 ? fminf(-team.minimum(-last) + SLACK * ARCS, ARCS) : 0;
  Vector axis = normalize(sum(team, total));
  Vector along = load(direction, begin + slot(min(count, SIDE < 4 ? SIDE : 4) - 1)) -
                 load(direction, begin + slot(0));
  along = along - dot(along, axis) * axis;
  Vector helper = fabsf(axis.x) < 0.6f ? Vector{1, 0, 0} : Vector{0, 1, 0};
  helper = helper - dot(helper, axis) * axis;
  Vector u = normalize(dot(along, along) > 1e-12f ? along : helper), v = cross(axis, u);
  float low = INFINITE, left = INFINITE, right = -INFINITE, down = INFINITE, up = -INFINITE;
  float nearest = INFINITE, farthest = -INFINITE;
  const Vector start = load(origin, begin + slot(0));
  bool apart = false;
  each([&](size_t, Vector o, Vector d) {
    float depth = dot(d, axis);
    apart = apart || !(o.x == start.x && o.y == start.y && o.z == start.z);
    low = fminf(low, depth);
    float inverse = 1 / (depth > WIDEST ? depth : 1);
    left = fminf(left, dot(d, u) * inverse);
    right = fmaxf(right, dot(d, u) * inverse);
    down = fminf(down, dot(d, v) * inverse);
    up = fmaxf(up, dot(d, v) * inverse);
    nearest = fminf(nearest, dot(axis, o));
    farthest = fmaxf(farthest, dot(axis, o));
  });
  low = team.minimum(low);
  left = team.minimum(left) - SLACK;
  right = -team.minimum(-right) + SLACK;
  down = team.minimum(down) - SLACK;
  up = -team.minimum(-up) + SLACK;
  nearest = team.minimum(nearest);
  farthest = -team.minimum(-farthest);
  // No ray: nothing is met. Too wide: everything may be.
  bool some = low < INFINITE, narrow = some && low > WIDEST;
  Vector side[4] = {normalize(u - left * axis), normalize(right * axis - u),
                    normalize(v - down * axis), normalize(up * axis - v)};
  float offset[4] = {INFINITE, INFINITE, INFINITE, INFINITE};
  each([&](size_t, Vector o, Vector) {
    for (int i = 0; i < 4; i++) offset[i] = fminf(offset[i], dot(side[i], o));
  });
  float slack = SLACK * magnitude;
  b.plane[0] = {axis.x, axis.y, axis.z, nearest - slack};
  for (int i = 0; i < 4; i++)
    b.plane[i + 1] = {side[i].x, side[i].y, side[i].z, team.minimum(offset[i]) - slack};
  b.reach = narrow ? farthest + slack : INFINITE;
  for (int i = 0; i < 5 && !narrow; i++) b.plane[i] = {0, 0, 0, some ? 0 : INFINITE};
  b.cosine = narrow ? low : 0;
  if (fan) {
    // Of every team, also one of no rays: a shuffle that some lanes of a warp leave out never ends.
    const float together = team.minimum(apart ? 0 : 1);
    *fan = {start, axis, u, v, left, right, down, up, narrow && together == 1};
  }
  return b;
}

// ---------------------------------------------------------------- what a group may meet

__device__ __forceinline__ bool touches_box(const Bounds &b, const float *box) {
  for (int i = 0; i < 5; i++) {
    float4 p = b.plane[i];
    float far = fmaxf(p.x * box[0], p.x * box[3]) + fmaxf(p.y * box[1], p.y * box[4]) +
                fmaxf(p.z * box[2], p.z * box[5]);
    if (!(far >= p.w)) return false;
  }
  return true;
}

// Axes F = R S (row by row) of a Gaussian, and its mean, at one control point.
struct Frame {
  float f[9];
  Vector mean;
};

__device__ __forceinline__ Frame frame(const float4 *row) {
  float4 a = row[0], b = row[1], c = row[2];
  return {{a.x, a.y, a.z, a.w, b.x, b.y, b.z, b.w, c.x}, {c.y, c.z, c.w}};
}

// Height of the centre along n, and the square of half the height of the ellipsoid F.
__device__ __forceinline__ float2 support(const Frame &e, float4 n) {
  float part[3];
  for (int b = 0; b < 3; b++) part[b] = n.x * e.f[b] + n.y * e.f[3 + b] + n.z * e.f[6 + b];
  return {n.x * e.mean.x + n.y * e.mean.y + n.z * e.mean.z,
          part[0] * part[0] + part[1] * part[1] + part[2] * part[2]};
}

// Control point `c` of the part of an arc from `begin` to `end`: of a parabola the one at the start,
// the blossom of both ends, or the one at the end; of a line one of its ends.
__device__ __forceinline__ Frame control_of_part(const float4 *row, float begin, float end, int c) {
  float x = c < 2 && !(KEYS == 2 && c == 1) ? begin : end, y = c < 1 ? begin : end;
  float w[3] = {(1 - x) * (1 - y), x * (1 - y) + y * (1 - x), x * y};
  if (KEYS == 2) {
    w[0] = 1 - x;
    w[1] = x;
  }
  Frame sum = {};
  for (int k = 0; k < (KEYS == 2 ? 2 : 3); k++) {
    Frame e = frame(row + 4 * k);
    for (int i = 0; i < 9; i++) sum.f[i] += w[k] * e.f[i];
    sum.mean = sum.mean + w[k] * e.mean;
  }
  return sum;
}

// Whether an ellipsoid reaches into a half-space.
__device__ __forceinline__ bool reaches(float2 support, float4 plane) {
  float gap = plane.w - support.x;
  return gap <= 0 || support.y >= gap * gap;
}

// What a moving Gaussian sweeps while the group's times pass: `visit` sees its control points.
template <class Visit>
__device__ __forceinline__ void sweep(const Bounds &b, const float4 *keyed, int moving,
                                      Visit visit) {
  for (int arc = (int)b.begin; arc < ARCS && arc <= b.end; arc++) {
    float begin = fmaxf(b.begin - arc, 0), end = fminf(b.end - arc, 1);
    for (int c = 0; c < (KEYS == 2 ? 2 : 3); c++)
      visit(control_of_part(keyed + 4 * ((size_t)moving * KEYS + 2 * arc), begin, end, c));
  }
}

// How a transient Gaussian moves and fades: see scene/transient.py.
struct Window {
  Vector velocity;
  float instant, rate, plateau;
};

// Number of the window of a Gaussian, given its place among the moving: -2 is the first one.
__device__ __forceinline__ int window_of(int moving) { return -2 - moving; }

__device__ __forceinline__ Window window_at(const float4 *window, int i) {
  float4 a = window[2 * (size_t)i], b = window[2 * (size_t)i + 1];
  return {{a.x, a.y, a.z}, a.w, b.x, b.y};
}

// Distance in time, in lifetimes.
__device__ __forceinline__ float flank(const Window &w, float age) {
  return fmaxf(fabsf(age) - w.plateau, 0) * w.rate;
}

// What is tested against the bounds of rays: a Gaussian, its row among the moving (or -1; less for
// transient ones), its reach, and the ellipsoid of one that rests or is transient.
struct Body {
  Frame rest;
  int moving;
  float reach;
#if TRANSIENT
  Window window;
#endif
};

__device__ __forceinline__ Body body(const float4 *extent, const float4 *window, int id,
                                     float4 last) {
  Body body = {{}, KEYS == 1 && !TRANSIENT ? -1 : (int)last.z, sqrtf(last.y)};
  if (body.moving < 0) body.rest = frame(extent + 3 * (size_t)id);
#if TRANSIENT
  if (body.moving < -1) body.window = window_at(window, window_of(body.moving));
#endif
  return body;
}

#if TRANSIENT
// What a transient Gaussian does in the group's time (window.py): its displacements when it is first
// and last alive, and by how much its ellipsoid is smaller than at full opacity (0: not alive).
struct Sweep {
  Vector first, last;
  float shrink;
};

__device__ __forceinline__ Sweep sweep(const Bounds &b, const Body &body) {
  const Window &w = body.window;
  const float slack = 1 + 8 * EPSILON, squared = slack * body.reach * body.reach;
  float first = b.earliest - w.instant, last = b.latest - w.instant;
  const float s = flank(w, fmaxf(fmaxf(first, -last), 0));
  const bool alive = s * s < squared && first <= last;
  const float shrink = sqrtf(fmaxf(1 - s * s / squared, 0)) * slack + 8 * EPSILON;
  const float length = w.rate > 0 ? (w.plateau + body.reach / w.rate) * slack : INFINITE;
  first = fminf(fmaxf(first, -length), length);
  last = fminf(fmaxf(last, -length), length);
  return {first * w.velocity, last * w.velocity, alive ? fminf(shrink, 1) : 0};
}

__device__ __forceinline__ Vector normal(float4 plane) { return {plane.x, plane.y, plane.z}; }
#endif

// False where it lies outside one of the half-spaces FROM to TO - 1.
template <int FROM, int TO>
__device__ __forceinline__ bool touches(const Bounds &b, const Body &body, const float4 *keyed) {
  bool inside = true;
#if TRANSIENT
  if (body.moving < -1) {
    const Sweep swept = sweep(b, body);
    inside = swept.shrink > 0;
    for (int i = FROM; i < TO; i++) {
      float2 s = support(body.rest, b.plane[i]);
      const Vector n = normal(b.plane[i]);
      s.x += fmaxf(dot(n, swept.first), dot(n, swept.last));
      s.y *= swept.shrink * swept.shrink;
      inside = inside && reaches(s, b.plane[i]);
    }
    return inside;
  }
#endif
  if (body.moving < 0) {
    for (int i = FROM; i < TO; i++)
      inside = inside && reaches(support(body.rest, b.plane[i]), b.plane[i]);
    return inside;
  }
  float top[5];
  for (int i = FROM; i < TO; i++) top[i] = -INFINITE;
  sweep(b, keyed, body.moving, [&](const Frame &e) {
    for (int i = FROM; i < TO; i++) {
      float2 s = support(e, b.plane[i]);
      top[i] = fmaxf(top[i], s.x + body.reach * sqrtf(s.y));
    }
  });
  for (int i = FROM; i < TO; i++) inside = inside && top[i] >= b.plane[i].w;
  return inside;
}

// Squared lengths of the axes, inverted; 0 where that is not finite.
__device__ __forceinline__ Vector inverse_squares(const Frame &e) {
  float inverse[3];
  for (int i = 0; i < 3; i++) {
    inverse[i] = 1 / (e.f[i] * e.f[i] + e.f[3 + i] * e.f[3 + i] + e.f[6 + i] * e.f[6 + i]);
    if (!(inverse[i] < INFINITE)) inverse[i] = 0;
  }
  return {inverse[0], inverse[1], inverse[2]};
}

// F^T x
__device__ __forceinline__ Vector across_axes(const Frame &e, Vector x) {
  return {e.f[0] * x.x + e.f[3] * x.y + e.f[6] * x.z, e.f[1] * x.x + e.f[4] * x.y + e.f[7] * x.z,
          e.f[2] * x.x + e.f[5] * x.y + e.f[8] * x.z};
}

__device__ __forceinline__ Vector termwise(Vector a, Vector b) {
  return {a.x * b.x, a.y * b.y, a.z * b.z};
}

// A lower bound of n.x over the peaks x of an ellipsoid |A (x - mean)| <= 1, A = F^-1, along the rays
// of a group: not where the ellipsoid begins, but where rays are nearest to its centre. The ellipsoid
// is F, smaller by `shrink`, anywhere from the mean + `first` to the mean + `last`.
//
// At a peak y = A (x - mean) is normal to A d. Of w = F^T n, whose product with A d is n.d, the part
// normal to A d is at most sqrt(w^2 - (n.d / |A d|)^2), and |A d| <= |A n| + |d - n| / (least axis).
// If all rays begin at o, x = o + s e with e = axis + x u + y v, and
// s = (A e).(A (mean - o)) / (A e)^2: the numerator is least and the denominator largest at corners.
__device__ __forceinline__ float least_peak(const Bounds &b, const Fan &fan, const Frame &e,
                                            float shrink, Vector first, Vector last) {
  const Vector n = {b.plane[0].x, b.plane[0].y, b.plane[0].z};
  const Vector w = across_axes(e, n), inverse = inverse_squares(e);
  const float middle = dot(n, e.mean) + fminf(dot(n, first), dot(n, last));
  const float height = sqrtf(dot(w, w)), an = sqrtf(dot(termwise(w, inverse), termwise(w, inverse)));
  const float thin = sqrtf(fmaxf(inverse.x, fmaxf(inverse.y, inverse.z)));
  const float apart = sqrtf(fmaxf(2 - 2 * b.cosine, 0) + SLACK);
  const float along = b.cosine / (an + apart * thin);
  float part = sqrtf(fmaxf(height * height * (1 + SLACK) - along * along, 0));
  const bool fine = inverse.x > 0 && inverse.y > 0 && inverse.z > 0 && an > 0;
  part = fine ? fminf(part + PEAK_SLACK * height, height) : height;
  float least = middle - shrink * part;
  if (!fine || !fan.one) return least;
  const Vector p = e.mean - fan.origin;
  const Vector q = across_axes(e, p + first), r = across_axes(e, p + last);
  const Vector aq = termwise(q, inverse), ar = termwise(r, inverse);
  float numerator = INFINITE, denominator = 0;
  for (int i = 0; i < 4; i++) {
    const Vector d = fan.axis + (i & 1 ? fan.right : fan.left) * fan.u +
                     (i & 2 ? fan.up : fan.down) * fan.v;
    const Vector ad = termwise(across_axes(e, d), inverse);
    numerator = fminf(numerator, fminf(dot(ad, aq), dot(ad, ar)));
    denominator = fmaxf(denominator, dot(ad, ad));
  }
  numerator -= SLACK * sqrtf(denominator * fmaxf(dot(aq, aq), dot(ar, ar)));
  const float s = numerator / denominator;
  // Not a number where axes are too thin or too long.
  if (numerator > 0 && s < INFINITE)
    least = fmaxf(least, s + dot(n, fan.origin) - shrink * PEAK_SLACK * height);
  return least;
}

// A distance that no ray of the group has to travel less to the peak of a hit.
__device__ __forceinline__ float nearest(const Bounds &b, const Fan &fan, const Body &body,
                                         const float4 *keyed) {
  float least = INFINITE;
  const Vector still = {0, 0, 0};
#if TRANSIENT
  if (body.moving < -1) {
    const Sweep swept = sweep(b, body);
    least = least_peak(b, fan, body.rest, swept.shrink, swept.first, swept.last);
  } else
#endif
  if (body.moving < 0)
    least = least_peak(b, fan, body.rest, 1, still, still);
  else
    sweep(b, keyed, body.moving, [&](const Frame &e) {
      float2 s = support(e, b.plane[0]);
      least = fminf(least, s.x - body.reach * sqrtf(s.y));
    });
  return fmaxf(least - b.reach - SLACK * (fabsf(least) + fabsf(b.reach)), 0.0f);
}

// One block lists what one group of rays may meet: boxes of 256 Gaussians, then of 8, then
// ellipsoids; sorted into buckets by the least distance, those of a bucket (which share a bound) in
// the order of the Gaussians, so that the list does not depend on who came first. It also bounds the
// rays of each band.
extern "C" __global__ void __launch_bounds__(TEAM)
gather(const float *origin, const float *direction, const float4 *weight, const float *time,
       const int *order, const float *super, const float *cell, const float4 *extent,
       const float4 *state, const float4 *keyed, const float4 *window, int *list, float *bounds,
       Bounds *bands, int *count, int *found, float *distance) {
  __shared__ Bounds b;
  __shared__ Fan fan;
  __shared__ float scratch[TEAM / 32];
  __shared__ u32 histogram[BUCKETS], lowest[BUCKETS], partial[TEAM / 32];
  __shared__ u32 total, low, high;
  __shared__ int queue[TEAM / 32][32];
  int lane = threadIdx.x & 31, warp = threadIdx.x >> 5;
  size_t own = (size_t)blockIdx.x * SLOTS;
  const size_t first_ray = (size_t)blockIdx.x * GROUP;
  {
    Block team = {scratch};
    Fan rays;
    Bounds mine = bound(team, origin, direction, weight, time, first_ray, SAMPLES, GROUP,
                        [](int i) { return i; }, &rays);
    if (threadIdx.x == 0) {
      b = mine;
      fan = rays;
      total = 0;
      low = 0x7f800000u;
      high = 0;
    }
  }
  for (int base = 0; base < BANDS * SAMPLES; base += TEAM / WIDE) {
    const int at = base + threadIdx.x / WIDE, i = min(at, BANDS * SAMPLES - 1);
    const int sample = i / BANDS, band = i % BANDS;
    Bounds mine = bound(Lanes(), origin, direction, weight, time,
                        (size_t)sample * RAYS + first_ray, 1, rays_in(band),
                        [band](int i) { return slot_in(band, i); }, nullptr);
    if (at == i && threadIdx.x % WIDE == 0)
      bands[((size_t)sample * (RAYS / GROUP) + blockIdx.x) * BANDS + band] = mine;
  }
  __syncthreads();
  int least = 0x7f800000, most = 0;
  for (int base = 0; base < SUPERS; base += TEAM) {
    int s = base + lane * (TEAM / 32) + warp;
    bool met = s < SUPERS && touches_box(b, super + 6 * (size_t)s);
    for (u32 left = __ballot_sync(ALL, met); left; left &= left - 1) {
      int parent = __shfl_sync(ALL, s, __ffs(left) - 1);
      int c = 32 * parent + lane;
      bool hit = touches_box(b, cell + 6 * (size_t)c);
      u32 mask = __ballot_sync(ALL, hit);
      if (hit) queue[warp][__popc(mask & ((1u << lane) - 1))] = c;
      __syncwarp();
      int cells = __popc(mask);
      for (int i = 0; i < cells; i += 4) {
        int j = i + (lane >> 3), id = -1;
        if (j < cells) id = order[8 * queue[warp][j] + (lane & 7)];
        float near = 0;
        float4 last = id < 0 ? float4{0, -1, -1, 0} : state[4 * (size_t)id + 3];
        bool in = last.y > 0;
        if (in) {
          Body met = body(extent, window, id, last);
          in = touches<0, 5>(b, met, keyed);
          if (in) near = nearest(b, fan, met, keyed);
        }
        u32 mine = __ballot_sync(ALL, in);
        u32 at = 0;
        if (lane == 0 && mine) at = atomicAdd(&total, __popc(mine));
        at = __shfl_sync(ALL, at, 0) + __popc(mine & ((1u << lane) - 1));
        if (in && at < SLOTS) {
          list[own + at] = id;
          distance[own + at] = near;
          least = min(least, __float_as_int(near));
          most = max(most, __float_as_int(near));
        }
      }
      __syncwarp();
    }
  }
  least = least_of_warp(least);
  most = -least_of_warp(-most);
  if (lane == 0) {
    atomicMin(&low, (u32)least);
    atomicMax(&high, (u32)most);
  }
  for (int i = threadIdx.x; i < BUCKETS; i += TEAM) {
    histogram[i] = 0;
    lowest[i] = 0x7f800000u;
  }
  __syncthreads();
  int held = min(total, (u32)SLOTS);
  if (threadIdx.x == 0) count[blockIdx.x] = total;
  // Buckets of equal ratio; what is thousands of times nearer than the farthest shares the first.
  u32 begin = max(low, high > (12u << 23) ? high - (12u << 23) : 0u);
  float scale = (BUCKETS - 1) / fmaxf((float)(high - begin), 1.0f);
  auto bucket = [&](u32 bits) {
    return min((int)((float)(max(bits, begin) - begin) * scale), BUCKETS - 1);
  };
  for (int i = threadIdx.x; i < held; i += TEAM) {
    u32 bits = __float_as_uint(distance[own + i]);
    atomicAdd(&histogram[bucket(bits)], 1u);
    atomicMin(&lowest[bucket(bits)], bits);
  }
  __syncthreads();
  u32 before[OWN], run = 0;
  for (int i = 0; i < OWN; i++) {
    before[i] = run;
    run += histogram[OWN * threadIdx.x + i];
  }
  u32 scan = run;
  for (int i = 1; i < 32; i <<= 1) {
    u32 other = __shfl_up_sync(ALL, scan, i);
    if (lane >= i) scan += other;
  }
  if (lane == 31) partial[warp] = scan;
  __syncthreads();
  u32 offset = scan - run;
  for (int i = 0; i < warp; i++) offset += partial[i];
  for (int i = 0; i < OWN; i++) histogram[OWN * threadIdx.x + i] = offset + before[i];
  __syncthreads();
  for (int i = threadIdx.x; i < held; i += TEAM) {
    int in = bucket(__float_as_uint(distance[own + i]));
    u32 at = atomicAdd(&histogram[in], 1u);
    found[own + at] = list[own + i];
    bounds[own + at] = __uint_as_float(lowest[in]);
  }
  __syncthreads();
  for (int i = threadIdx.x; i < held; i += TEAM) {
    const int id = found[own + i];
    const float bound = bounds[own + i];
    int place = i;
    for (int j = i - 1; j >= 0 && bounds[own + j] == bound; j--) place -= found[own + j] > id;
    for (int j = i + 1; j < held && bounds[own + j] == bound; j++) place += found[own + j] < id;
    list[own + place] = id;
  }
}

// Which parts may meet an entry: a word of 32 entries for each part and sample.
extern "C" __global__ void __launch_bounds__(128)
sift(const int *list, const Bounds *bands, const int *count, const float4 *extent,
     const float4 *state, const float4 *keyed, const float4 *window, u32 *words) {
  const size_t group = blockIdx.x / ((SLOTS + 127) / 128), groups = RAYS / GROUP;
  const int begin = blockIdx.x % ((SLOTS + 127) / 128) * 128;
  const int held = min(count[group], SLOTS);
  if (begin >= held) return;
  __shared__ Bounds own[BANDS];
  const int lane = threadIdx.x & 31, at = begin + threadIdx.x, word = at / 32;
  const int id = at < held ? list[group * SLOTS + at] : -1;
  const int column = column_of(lane), row = row_of(lane);
  Body entry = {{}, -1, 0};
  if (id >= 0) entry = body(extent, window, id, state[4 * (size_t)id + 3]);
  for (int sample = 0; sample < SAMPLES; sample++) {
    const size_t place = sample * groups + group;
    const float *from = (const float *)(bands + place * BANDS);
    __syncthreads();
    for (int i = threadIdx.x; i < BANDS * sizeof(Bounds) / 4; i += 128)
      ((float *)own)[i] = from[i];
    __syncthreads();
    u32 met = ALL;
    for (int i = 0; i < COLUMNS_OF_PARTS; i++) {
      u32 some = __ballot_sync(ALL, id >= 0 && touches<1, 3>(own[i], entry, keyed));
      if (i == column) met &= some;
    }
    for (int i = 0; i < ROWS_OF_PARTS; i++) {
      const Bounds &b = own[COLUMNS_OF_PARTS + i];
      u32 some = __ballot_sync(ALL, id >= 0 && touches<SQUARE ? 3 : 1, 5>(b, entry, keyed));
      if (i == row) met &= some;
    }
    if (lane < PARTS && 32 * word < held) words[(place * WORDS + word) * PARTS + lane] = met;
  }
}

// ---------------------------------------------------------------- one ray meets one Gaussian

struct Ray {
  Vector o, d;
  float4 weight;
#if TRANSIENT
  float time;
#endif
};

// A = S^-1 R^T (row by row), mean, opacity, squared reach and place among the moving (-1: it rests;
// less: it is transient, see `window_of`).
struct Matter {
  float a[9];
  Vector mean;
  float opacity, reach;
  int moving;
};

__device__ __forceinline__ Matter matter(float4 r0, float4 r1, float4 r2, float4 r3) {
  return {{r0.x, r0.y, r0.z, r0.w, r1.x, r1.y, r1.z, r1.w, r2.x},
          {r2.y, r2.z, r2.w},
          r3.x,
          r3.y,
          (int)r3.z};
}

// Row of one of the (at most) three control points of the ray's arc.
__device__ __forceinline__ size_t control(const Ray &ray, int moving, int i) {
  return 4 * ((size_t)moving * KEYS + min((int)ray.weight.w + i, KEYS - 1));
}

// Inverse by cofactors; each column is first divided by its largest entry (see motion.py).
__device__ __forceinline__ void invert(const float *f, float *a) {
  Vector column[3];
  float size[3];
  for (int i = 0; i < 3; i++) {
    column[i] = {f[i], f[3 + i], f[6 + i]};
    size[i] = fmaxf(fmaxf(fabsf(column[i].x), fabsf(column[i].y)), fabsf(column[i].z));
    size[i] = size[i] > 0 ? size[i] : 1;
    column[i] = (1 / size[i]) * column[i];
  }
  Vector row[3] = {cross(column[1], column[2]), cross(column[2], column[0]),
                   cross(column[0], column[1])};
  float determinant = dot(column[0], row[0]);
  determinant = determinant == 0 ? 1 : determinant;
  for (int i = 0; i < 3; i++) {
    Vector r = (1 / (determinant * size[i])) * row[i];
    a[3 * i] = r.x;
    a[3 * i + 1] = r.y;
    a[3 * i + 2] = r.z;
  }
}

// A moving Gaussian at the time of the ray; `tint` is blended too.
__device__ __forceinline__ void blend(const Ray &ray, const float4 *keyed, Matter &m,
                                      Vector &tint) {
  float w[3] = {ray.weight.x, ray.weight.y, ray.weight.z}, sum[16];
  for (int i = 0; i < 16; i++) sum[i] = 0;
  for (int i = 0; i < 3; i++) {
    const float4 *row = keyed + control(ray, m.moving, i);
    for (int j = 0; j < 4; j++) {
      if (j == 3 && !TINTED) continue;
      float4 r = row[j];
      sum[4 * j] += w[i] * r.x;
      sum[4 * j + 1] += w[i] * r.y;
      sum[4 * j + 2] += w[i] * r.z;
      sum[4 * j + 3] += w[i] * r.w;
    }
  }
  invert(sum, m.a);
  m.mean = {sum[9], sum[10], sum[11]};
  tint = {sum[12], sum[13], sum[14]};
}

#if TRANSIENT
// Takes a transient Gaussian to the time of the ray; returns its squared distance in time.
__device__ __forceinline__ float pass(const Ray &ray, const float4 *window, Matter &m) {
  const Window w = window_at(window, window_of(m.moving));
  const float age = ray.time - w.instant, s = flank(w, age);
  m.mean = m.mean + age * w.velocity;
  return s * s;
}
#endif

// Distance t of the peak along the ray and squared distance q there (response.py), and what they
// are made of.
struct Meeting {
  float t, q, shift, inverse;
  Vector p, moved, o, v, c;
};

__device__ __forceinline__ Vector apply(const float *a, Vector x) {
  return {a[0] * x.x + a[1] * x.y + a[2] * x.z, a[3] * x.x + a[4] * x.y + a[5] * x.z,
          a[6] * x.x + a[7] * x.y + a[8] * x.z};
}

// To the last digit or so, without the branches of a division.
__device__ __forceinline__ float reciprocal(float x) {
  float y;
  asm("rcp.approx.f32 %0, %1;" : "=f"(y) : "f"(x));
  return y;
}

// exp(-q / 2)
__device__ __forceinline__ float gauss(float q) { return exp2f(-0.72134752044f * q); }

__device__ __forceinline__ Meeting meet(const Matter &m, const Ray &ray) {
  Meeting r;
  r.p = ray.o - m.mean;
  r.shift = -dot(r.p, ray.d);
  r.moved = r.p + r.shift * ray.d;
  r.o = apply(m.a, r.moved);
  r.v = apply(m.a, ray.d);
  float square = dot(r.v, r.v);
  r.inverse = square > 0 ? reciprocal(square) : 1;
  r.c = cross(r.o, r.v);
  r.t = r.shift - dot(r.o, r.v) * r.inverse;
  r.q = square > 0 ? dot(r.c, r.c) * r.inverse : INFINITE;
  return r;
}

// ---------------------------------------------------------------- colour

__device__ __forceinline__ void harmonics(Vector d, float *y) {
  float x = d.x, yy = d.y, z = d.z;
  y[0] = 0.28209479177387814f;
  if (HARMONICS > 1) {
    y[1] = -0.4886025119029199f * yy;
    y[2] = 0.4886025119029199f * z;
    y[3] = -0.4886025119029199f * x;
  }
  if (HARMONICS > 4) {
    y[4] = 1.0925484305920792f * x * yy;
    y[5] = -1.0925484305920792f * yy * z;
    y[6] = 0.31539156525252005f * (2 * z * z - x * x - yy * yy);
    y[7] = -1.0925484305920792f * x * z;
    y[8] = 0.5462742152960396f * (x * x - yy * yy);
  }
  if (HARMONICS > 9) {
    y[9] = -0.5900435899266435f * yy * (3 * x * x - yy * yy);
    y[10] = 2.890611442640554f * x * yy * z;
    y[11] = -0.4570457994644658f * yy * (4 * z * z - x * x - yy * yy);
    y[12] = 0.3731763325901154f * z * (2 * z * z - 3 * x * x - 3 * yy * yy);
    y[13] = -0.4570457994644658f * x * (4 * z * z - x * x - yy * yy);
    y[14] = 1.445305721320277f * z * (x * x - yy * yy);
    y[15] = -0.5900435899266435f * x * (x * x - 3 * yy * yy);
  }
}

// Gradient to the direction, given that to each harmonic.
__device__ __forceinline__ Vector harmonics_back(Vector d, const float *g) {
  float x = d.x, y = d.y, z = d.z;
  Vector s = {0, 0, 0};
  if (HARMONICS > 1) {
    s = {-0.4886025119029199f * g[3], -0.4886025119029199f * g[1], 0.4886025119029199f * g[2]};
  }
  if (HARMONICS > 4) {
    float a = 1.0925484305920792f, b = 0.31539156525252005f, c = 0.5462742152960396f;
    s.x += a * (y * g[4] - z * g[7]) - 2 * b * x * g[6] + 2 * c * x * g[8];
    s.y += a * (x * g[4] - z * g[5]) - 2 * b * y * g[6] - 2 * c * y * g[8];
    s.z += -a * (y * g[5] + x * g[7]) + 4 * b * z * g[6];
  }
  if (HARMONICS > 9) {
    float a = 0.5900435899266435f, b = 2.890611442640554f, c = 0.4570457994644658f;
    float f = 0.3731763325901154f, e = 1.445305721320277f;
    s.x += -6 * a * x * y * g[9] + b * y * z * g[10] + 2 * c * x * y * g[11] -
           6 * f * x * z * g[12] - c * (4 * z * z - 3 * x * x - y * y) * g[13] +
           2 * e * x * z * g[14] - 3 * a * (x * x - y * y) * g[15];
    s.y += -3 * a * (x * x - y * y) * g[9] + b * x * z * g[10] -
           c * (4 * z * z - x * x - 3 * y * y) * g[11] - 6 * f * y * z * g[12] +
           2 * c * x * y * g[13] - 2 * e * y * z * g[14] + 6 * a * x * y * g[15];
    s.z += b * x * y * g[10] - 8 * c * y * z * g[11] +
           f * (6 * z * z - 3 * x * x - 3 * y * y) * g[12] - 8 * c * x * z * g[13] +
           e * (x * x - y * y) * g[14];
  }
  return s;
}

// ---------------------------------------------------------------- the march

struct Scene {
  const float4 *state, *keyed;
  const float *color;
  const float4 *window;
};

// What a lane has gathered of its ray; `transmittance` is the same for all lanes of a ray.
struct Path {
  float4 sum;
  float transmittance;
  int hits;
};

// Gradients: `g` to the pixel, `rest` to what is still to come (the same for all lanes of a ray).
struct Slope {
  float4 g;
  float rest;
  Vector d_origin, d_direction, d_weight;
  float *state, *color, *keyed;
#if TRANSIENT
  float *window, d_time;
#endif
};

__device__ __forceinline__ void add(float *p, float4 v) {
#if __CUDA_ARCH__ >= 900
  atomicAdd((float4 *)p, v);
#else
  atomicAdd(p, v.x);
  atomicAdd(p + 1, v.y);
  atomicAdd(p + 2, v.z);
  atomicAdd(p + 3, v.w);
#endif
}

// Colour of a hit, and what its gradients are made of.
struct Look {
  Vector linear, seen, tint;
  float alpha, raw, kernel;
  bool moving;
  Matter m;
  Meeting r;
};

template <bool BACK>
__device__ __forceinline__ Look look(const Scene &scene, const Ray &ray, int id, float alpha) {
  const float4 *row = scene.state + 4 * (size_t)id;
  const float4 *color = (const float4 *)(scene.color + COLUMNS * (size_t)id);
  Look look;
  look.tint = {1, 1, 1};
  look.alpha = alpha;
  look.moving = false;
  if (BACK || (KEYS > 1 && TINTED)) {
    look.m = matter(row[0], row[1], row[2], row[3]);
    look.moving = KEYS > 1 && look.m.moving >= 0;
    if (look.moving) blend(ray, scene.keyed, look.m, look.tint);
  }
  if (BACK) {
#if TRANSIENT
    const float faded = look.m.moving < -1 ? pass(ray, scene.window, look.m) : 0;
#endif
    look.r = meet(look.m, ray);
#if TRANSIENT
    look.r.q += faded;
#endif
    look.kernel = gauss(look.r.q);
    look.raw = look.m.opacity * look.kernel;
    look.alpha = fminf(look.raw, ALPHA_MAX);
  }
  float y[HARMONICS], sum[3] = {0.5f, 0.5f, 0.5f}, tint[3];
  harmonics(ray.d, y);
#pragma unroll
  for (int i = 0; i < COLUMNS / 4; i++) {
    float4 v = color[i];
    float part[4] = {v.x, v.y, v.z, v.w};
#pragma unroll
    for (int j = 0; j < 4; j++) {
      int at = 4 * i + j;
      if (at < 3 * HARMONICS)
        sum[at % 3] += y[at / 3] * part[j];
      else if (TINTED && at < 3 * HARMONICS + 3)
        tint[at % 3] = part[j];
    }
  }
  if (TINTED && !look.moving) look.tint = {tint[0], tint[1], tint[2]};
  look.linear = {sum[0], sum[1], sum[2]};
  look.seen = {fmaxf(sum[0], 0), fmaxf(sum[1], 0), fmaxf(sum[2], 0)};
  if (TINTED)
    look.seen = {look.seen.x * fmaxf(look.tint.x, 0), look.seen.y * fmaxf(look.tint.y, 0),
                 look.seen.z * fmaxf(look.tint.z, 0)};
  return look;
}

// Gradients of a hit at t with `transmittance` in front of it, that adds `added` of the `rest`.
__device__ __forceinline__ void learn(const Scene &scene, const Ray &ray, int id, float t,
                                      const Look &look, float transmittance, float added,
                                      float rest, Slope *slope) {
  const float *color = scene.color + COLUMNS * (size_t)id;
  const float4 g = slope->g;
  const Vector linear = look.linear, tint = look.tint;
  const Vector radiance = {fmaxf(linear.x, 0), fmaxf(linear.y, 0), fmaxf(linear.z, 0)};
  const Matter &m = look.m;
  const Meeting &r = look.r;
  const float raw = look.raw, kernel = look.kernel, weight = transmittance * look.alpha;
  const bool moving = look.moving;
  float y[HARMONICS];
  harmonics(ray.d, y);
  // weight_i = alpha_i T_i; what follows is dimmed by 1 - alpha_i.
  float now = g.x * look.seen.x + g.y * look.seen.y + g.z * look.seen.z + g.w * t;
  float d_alpha = transmittance * now - (rest - added) / (1 - look.alpha);
  float d_raw = raw < ALPHA_MAX ? d_alpha : 0;
  float d_q = -0.5f * raw * d_raw, d_t = weight * g.w;
  // Colour.
  Vector d_seen = {weight * g.x, weight * g.y, weight * g.z}, d_tint = {0, 0, 0};
  if (TINTED) {
    d_tint = {tint.x > 0 ? d_seen.x * radiance.x : 0, tint.y > 0 ? d_seen.y * radiance.y : 0,
              tint.z > 0 ? d_seen.z * radiance.z : 0};
    d_seen = {d_seen.x * fmaxf(tint.x, 0), d_seen.y * fmaxf(tint.y, 0),
              d_seen.z * fmaxf(tint.z, 0)};
  }
  Vector d_linear = {linear.x > 0 ? d_seen.x : 0, linear.y > 0 ? d_seen.y : 0,
                     linear.z > 0 ? d_seen.z : 0};
  float d_color[COLUMNS], d_y[HARMONICS];
  for (int i = 0; i < COLUMNS; i++) d_color[i] = 0;
  for (int i = 0; i < HARMONICS; i++) {
    store(d_color, i, y[i] * d_linear);
    d_y[i] = dot(load(color, i), d_linear);
  }
  if (TINTED && !moving) store(d_color, HARMONICS, d_tint);
  float *colors = slope->color + COLUMNS * (size_t)id;
  for (int i = 0; i < COLUMNS; i += 4)
    add(colors + i, {d_color[i], d_color[i + 1], d_color[i + 2], d_color[i + 3]});
  Vector d_d = harmonics_back(ray.d, d_y);
  // Response, backwards through the lines of `meet`.
  float along = dot(r.o, r.v), square = dot(r.c, r.c);
  float d_inverse = square * d_q - along * d_t, d_along = -r.inverse * d_t;
  Vector d_c = (2 * r.inverse * d_q) * r.c;
  // Not inverse * inverse, the fourth power of a size: it overflows at 1e10.
  float d_square = -r.inverse * (r.inverse * d_inverse);
  Vector d_o = d_along * r.v + cross(r.v, d_c);
  Vector d_v = d_along * r.o + cross(d_c, r.o) + (2 * d_square) * r.v;
  float a[9];
  for (int i = 0; i < 9; i++) a[i] = m.a[i];
  Vector d_moved = {a[0] * d_o.x + a[3] * d_o.y + a[6] * d_o.z,
                    a[1] * d_o.x + a[4] * d_o.y + a[7] * d_o.z,
                    a[2] * d_o.x + a[5] * d_o.y + a[8] * d_o.z};
  d_d = d_d + Vector{a[0] * d_v.x + a[3] * d_v.y + a[6] * d_v.z,
                     a[1] * d_v.x + a[4] * d_v.y + a[7] * d_v.z,
                     a[2] * d_v.x + a[5] * d_v.y + a[8] * d_v.z};
  float d_shift = d_t + dot(d_moved, ray.d);
  Vector d_p = d_moved - d_shift * ray.d;
  d_d = d_d + r.shift * d_moved - d_shift * r.p;
  slope->d_origin = slope->d_origin + d_p;
  slope->d_direction = slope->d_direction + d_d;
  float o[3] = {d_o.x, d_o.y, d_o.z}, v[3] = {d_v.x, d_v.y, d_v.z};
  float x[3] = {r.moved.x, r.moved.y, r.moved.z}, d[3] = {ray.d.x, ray.d.y, ray.d.z};
  float d_a[9];
  for (int i = 0; i < 9; i++) d_a[i] = o[i / 3] * x[i % 3] + v[i / 3] * d[i % 3];
  float *states = slope->state + 16 * (size_t)id;
  float4 d_opacity = {raw < ALPHA_MAX ? d_raw * kernel : 0, 0, 0, 0};
  if (!moving) {
    add(states, {d_a[0], d_a[1], d_a[2], d_a[3]});
    add(states + 4, {d_a[4], d_a[5], d_a[6], d_a[7]});
    add(states + 8, {d_a[8], -d_p.x, -d_p.y, -d_p.z});
    add(states + 12, d_opacity);
#if TRANSIENT
    if (m.moving < -1) {
      const Window w = window_at(scene.window, window_of(m.moving));
      const float age = ray.time - w.instant, s = flank(w, age);
      const float d_s = 2 * s * d_q, d_beyond = d_s * w.rate;
      const float d_age = (age < 0 ? -d_beyond : d_beyond) - dot(d_p, w.velocity);
      float *windows = slope->window + 8 * (size_t)window_of(m.moving);
      add(windows, {-age * d_p.x, -age * d_p.y, -age * d_p.z, -d_age});
      add(windows + 4, {d_s * fmaxf(fabsf(age) - w.plateau, 0), -d_beyond, 0, 0});
      slope->d_time += d_age;
    }
#endif
  } else {
    add(states + 12, d_opacity);
    // F = A^-1: dF = -A^T dA A^T.
    float half[9], d_f[9];
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++)
        half[3 * i + j] = d_a[3 * i] * a[3 * j] + d_a[3 * i + 1] * a[3 * j + 1] +
                          d_a[3 * i + 2] * a[3 * j + 2];
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++)
        d_f[3 * i + j] = -(a[i] * half[j] + a[3 + i] * half[3 + j] + a[6 + i] * half[6 + j]);
    float4 grad[4] = {{d_f[0], d_f[1], d_f[2], d_f[3]},
                      {d_f[4], d_f[5], d_f[6], d_f[7]},
                      {d_f[8], -d_p.x, -d_p.y, -d_p.z},
                      {d_tint.x, d_tint.y, d_tint.z, 0}};
    float w[3] = {ray.weight.x, ray.weight.y, ray.weight.z}, d_w[3];
    for (int i = 0; i < 3; i++) {
      size_t at = control(ray, m.moving, i);
      d_w[i] = 0;
      for (int j = 0; j < 4; j++) {
        if (j == 3 && !TINTED) continue;
        float4 k = scene.keyed[at + j], s = grad[j];
        d_w[i] += k.x * s.x + k.y * s.y + k.z * s.z + k.w * s.w;
        if (w[i] != 0)
          add(slope->keyed + 4 * (at + j), {w[i] * s.x, w[i] * s.y, w[i] * s.z, w[i] * s.w});
      }
    }
    slope->d_weight = slope->d_weight + Vector{d_w[0], d_w[1], d_w[2]};
  }
}

// The hits of a lane that are still to be blended, nearest first; equally distant ones in the order
// of the list. An empty place is infinitely far.
struct Pending {
  float t[K], alpha[K];
  int place[K];

  __device__ __forceinline__ void clear() {
#pragma unroll
    for (int i = 0; i < K; i++) t[i] = INFINITE;
  }

  // The last hit has to give way.
  __device__ __forceinline__ void insert(float mine, float own, int from) {
#pragma unroll
    for (int i = K - 1; i > 0; i--) {
      bool here = mine < t[i], further = mine < t[i - 1];
      alpha[i] = here ? (further ? alpha[i - 1] : own) : alpha[i];
      place[i] = here ? (further ? place[i - 1] : from) : place[i];
      t[i] = here ? (further ? t[i - 1] : mine) : t[i];
    }
    alpha[0] = mine < t[0] ? own : alpha[0];
    place[0] = mine < t[0] ? from : place[0];
    t[0] = fminf(mine, t[0]);
  }

  // Forget the nearest, where told to.
  __device__ __forceinline__ void pop(bool gone) {
#pragma unroll
    for (int i = 0; i < K - 1; i++) {
      alpha[i] = gone ? alpha[i + 1] : alpha[i];
      place[i] = gone ? place[i + 1] : place[i];
      t[i] = gone ? t[i + 1] : t[i];
    }
    t[K - 1] = gone ? INFINITE : t[K - 1];
  }
};

// Where a hit stands in the order.
struct Rank {
  float t;
  int place;
  __device__ __forceinline__ bool operator<(Rank other) const {
    return t < other.t || (t == other.t && place < other.place);
  }
};

// Further pending hits of a lane, none nearer than those that are `Pending`: a heap in local memory,
// of which the nearest is on top. Children of hit i are 4 i + 1 to 4 i + 4. The lanes of a ray have
// room for 256 together.
#define MORE (256 / LANES)
struct Reserve {
  float t[MORE], alpha[MORE];
  int place[MORE], count;

  __device__ __forceinline__ Rank rank(int i) { return {t[i], place[i]}; }
  __device__ __forceinline__ void set(int i, Rank hit, float own) {
    t[i] = hit.t;
    place[i] = hit.place;
    alpha[i] = own;
  }

  // A hit that takes place i, or that of what is above it.
  __device__ __forceinline__ void rise(int i, Rank hit, float own) {
    while (i) {
      const int above = (i - 1) / 4;
      const Rank other = rank(above);
      if (!(hit < other)) break;
      set(i, other, alpha[above]);
      i = above;
    }
    set(i, hit, own);
  }

  // Takes a hit in. Returns the farthest one, which had to go, or one that is infinitely far.
  __device__ __forceinline__ Rank push(Rank hit, float own) {
    if (count < MORE) {
      rise(count++, hit, own);
      return {INFINITE, 0x7fffffff};
    }
    Rank farthest = hit;
    int at = -1;
    for (int i = (MORE + 2) / 4; i < MORE; i++) {
      const Rank other = rank(i);
      if (farthest < other) {
        farthest = other;
        at = i;
      }
    }
    if (at >= 0) rise(at, hit, own);
    return farthest;
  }

  // The nearest becomes the last of the pending ones.
  __device__ __forceinline__ void move_to(Pending &pending) {
    pending.t[K - 1] = t[0];
    pending.place[K - 1] = place[0];
    pending.alpha[K - 1] = alpha[0];
    const Rank hit = rank(--count);
    const float own = alpha[count];
    int i = 0;
    for (int child = 1; child < count; child = 4 * i + 1) {
      int best = child;
      Rank nearest = rank(child);
      for (int c = child + 1; c < min(child + 4, count); c++) {
        const Rank other = rank(c);
        if (other < nearest) {
          nearest = other;
          best = c;
        }
      }
      if (!(nearest < hit)) break;
      set(i, nearest, alpha[best]);
      i = best;
    }
    if (count) set(i, hit, own);
  }
};

// The least of the lanes of a ray.
__device__ __forceinline__ float least_of_ray(float v) {
  for (int i = LANES / 2; i; i >>= 1) v = fminf(v, __shfl_xor_sync(ALL, v, i));
  return v;
}
__device__ __forceinline__ int least_of_ray(int v) {
  for (int i = LANES / 2; i; i >>= 1) v = min(v, __shfl_xor_sync(ALL, v, i));
  return v;
}
__device__ __forceinline__ float sum_of_ray(float v) {
  for (int i = LANES / 2; i; i >>= 1) v += __shfl_xor_sync(ALL, v, i);
  return v;
}
__device__ __forceinline__ Rank least_of_ray(Rank v) {
  for (int i = LANES / 2; i; i >>= 1) {
    Rank other = {__shfl_xor_sync(ALL, v.t, i), __shfl_xor_sync(ALL, v.place, i)};
    if (other < v) v = other;
  }
  return v;
}

// Four or sixteen bytes on their way to shared memory, and how to wait for all of them.
template <class T>
__device__ __forceinline__ void copy(T *to, const T *from) {
#if __CUDA_ARCH__ >= 800
  u32 place = (u32)__cvta_generic_to_shared(to);
  asm volatile("cp.async.ca.shared.global [%0], [%1], %2;" ::"r"(place), "l"(from), "n"(sizeof(T))
               : "memory");
#else
  *to = *from;
#endif
}
__device__ __forceinline__ void arrive() {
#if __CUDA_ARCH__ >= 800
  asm volatile("cp.async.wait_all;" ::: "memory");
#endif
  __syncwarp();
}

// The entries of a group's list that a warp may meet, in order: a ring, read ahead. Rows are padded,
// so that lanes can read different ones at once.
#define RING 128
struct Queue {
  int id[RING], place[RING];
  float bound[RING];
  float4 row[2][32][5];
};

// A warp takes neighbouring rays through their group's list, 32 entries at a time. The lanes of a
// ray share the entries among them; each meets its own, then takes its hits in.
//
// Every lane keeps its K nearest pending hits in order, and more in reserve. The nearest one is
// blended once no later entry of the list and no second one of another lane can be nearer, so that
// the lanes of a ray often blend together. Hits for which the reserve has no room either are left to
// another pass over the list: `limit` is the nearest of them, and everything nearer is taken in this
// pass.
template <bool BACK>
__device__ void march(const Scene &scene, const int *list, const float *bounds, const u32 *words,
                      const int *count, size_t group, int sample, int part, const Ray &ray,
                      Path &path, Slope *slope) {
  __shared__ Queue queues[WARPS];
  __shared__ float distance[WARPS][WIDE][32], alphas[WARPS][WIDE][32];
  const int lane = threadIdx.x & 31, warp = threadIdx.x >> 5, own = lane % LANES;
  Queue &queue = queues[warp];
  const int entries = min(count[group], SLOTS);
  list += group * SLOTS;
  bounds += group * SLOTS;
  words += (sample * (size_t)(RAYS / GROUP) + group) * WORDS * PARTS + part / SPAN;

  // All rays at the same time: what moves is taken there once for all of them.
  bool steady = false;
  if (KEYS > 1 || TRANSIENT) {
    // Every lane takes part in every shuffle: a short-circuit around one would wait for ever.
    const float4 w = ray.weight;
    const float x = __shfl_sync(ALL, w.x, 0), y = __shfl_sync(ALL, w.y, 0);
    const float from = __shfl_sync(ALL, w.w, 0);
    bool same = w.x == x && w.y == y && w.w == from;
#if TRANSIENT
    const float time = __shfl_sync(ALL, ray.time, 0);
    same = same && ray.time == time;
#endif
    steady = __all_sync(ALL, same);
  }
  const Rank nothing = {INFINITE, 0x7fffffff};
  Pending pending;
  Reserve reserve;
  pending.clear();
  reserve.count = 0;
  Rank floor = {0, 0}, limit = nothing;
  int oldest = 0x7fffffff, start = 0;
  bool live = ray.d.x != 0 || ray.d.y != 0 || ray.d.z != 0;
  while (true) {
    // Each lane holds a word of 1024 entries from `base` on; `have` of the ring are from `first` on.
    int base = start & ~1023, first = 0, have = 0, turned = 0;
    u32 word = 0;
    bool open = live;
    auto window = [&]() {
      int at = base / 32 + lane;
      word = 32 * at < entries ? words[at * PARTS] : 0;
    };
    auto fill = [&]() {
      while (have < 64) {
        if (!__any_sync(ALL, word)) {
          base += 1024;
          if (base >= entries) break;
          window();
          continue;
        }
        // As many words as there is room for.
        const int own = __popc(word);
        int scan = own;
        for (int i = 1; i < 32; i <<= 1) {
          int other = __shfl_up_sync(ALL, scan, i);
          if (lane >= i) scan += other;
        }
        const bool fits = have + scan <= RING;
        const int total = __shfl_sync(ALL, scan, 31 - __clz(__ballot_sync(ALL, fits)));
        int at = first + have + scan - own;
        if (fits)
          for (; word; word &= word - 1)
            queue.place[at++ % RING] = base + 32 * lane + __ffs(word) - 1;
        __syncwarp();
        for (int i = lane; i < total; i += 32) {
          int slot = (first + have + i) % RING, place = queue.place[slot];
          copy(&queue.id[slot], list + place);
          copy(&queue.bound[slot], bounds + place);
        }
        have += total;
      }
    };
    // Rows of the ring's entries, 32 of them from `begin` on.
    auto stage = [&](int begin, int buffer) {
      for (int i = lane; i < 4 * min(have - begin, 32); i += 32)
        copy(&queue.row[buffer][i >> 2][i & 3],
             scene.state + 4 * (size_t)queue.id[(first + begin + (i >> 2)) % RING] + (i & 3));
    };
    window();
    const int before = start - base - 32 * lane;
    if (before > 0) word = before < 32 ? word & ALL << before : 0;
    fill();
    arrive();
    stage(0, 0);
    while (true) {
      arrive();
      const int staged = min(have, 32);
      stage(32, turned ^ 1);
      if ((KEYS > 1 || TRANSIENT) && steady) {
        float4 *row = queue.row[turned][lane];
        Matter m = matter(row[0], row[1], row[2], row[3]);
#if TRANSIENT
        if (lane < staged && m.moving < -1) {
          const float faded = pass(ray, scene.window, m);
          row[2] = {m.a[8], m.mean.x, m.mean.y, m.mean.z};
          row[3] = {m.opacity * gauss(faded), m.reach - faded, row[3].z, row[3].w};
        }
#endif
        if (KEYS > 1 && lane < staged && m.moving >= 0) {
          Vector unused;
          blend(ray, scene.keyed, m, unused);
          row[0] = {m.a[0], m.a[1], m.a[2], m.a[3]};
          row[1] = {m.a[4], m.a[5], m.a[6], m.a[7]};
          row[2] = {m.a[8], m.mean.x, m.mean.y, m.mean.z};
        }
        __syncwarp();
      }
      u32 hits = 0;
#pragma unroll 2
      for (int j = 0; j < (staged + LANES - 1) / LANES; j++) {
        const int e = j * LANES + own;
        const float4 *row = queue.row[turned][e];
        Matter m = matter(row[0], row[1], row[2], row[3]);
        if (KEYS > 1 && !steady && e < staged && m.moving >= 0) {
          Vector unused;
          blend(ray, scene.keyed, m, unused);
        }
#if TRANSIENT
        const bool fades = !steady && e < staged && m.moving < -1;
        const float faded = fades ? pass(ray, scene.window, m) : 0;
#endif
        Meeting r = meet(m, ray);
#if TRANSIENT
        r.q += faded;
#endif
        hits |= (u32)(e < staged && r.q < m.reach && r.t > 0) << j;
        distance[warp][j][lane] = r.t;
        alphas[warp][j][lane] = fminf(m.opacity * gauss(r.q), ALPHA_MAX);
      }
      if (!open) hits = 0;
      while (__any_sync(ALL, hits)) {
        int j = hits ? __ffs(hits) - 1 : 0;
        Rank mine = {distance[warp][j][lane], queue.place[(first + j * LANES + own) % RING]};
        if (hits && !(mine < floor) && mine < limit) {
          if (pending.t[0] == INFINITE) oldest = min(oldest, mine.place);
          Rank spare = mine;
          float own = alphas[warp][j][lane];
          // It comes later in the list than those that are pending.
          if (mine.t < pending.t[K - 1]) {
            spare = {pending.t[K - 1], pending.place[K - 1]};
            const float last = pending.alpha[K - 1];
            pending.insert(mine.t, own, mine.place);
            own = last;
          }
          if (spare.t < INFINITE) {
            const Rank gone = reserve.push(spare, own);
            if (gone.t < INFINITE) limit = gone;
          }
        }
        hits &= hits - 1;
      }
      // No later entry is met before this. Hits are blended when half the rays have one, or where
      // room or the list comes to an end.
      const float bar = have > 32 ? queue.bound[(first + 32) % RING] : INFINITE;
      const bool last = have <= 32;
      const Rank end = least_of_ray(limit);
      while (true) {
        const float t = pending.t[0], nearest = least_of_ray(t);
        const float rest = reserve.count ? reserve.t[0] : INFINITE;
        const float second = least_of_ray(K > 1 ? pending.t[K > 1] : rest);
        const bool ready = open && nearest < bar && nearest <= end.t;
        const bool crowded = 4 * reserve.count > 3 * MORE;
        const bool urgent = ready && (last || crowded || end.t < bar);
        // Beyond the limit there are hits that were not taken in.
        bool next = open && t < bar && (t < second || t == nearest) &&
                    Rank{t, pending.place[0]} < end;
        if (!__any_sync(ALL, next)) break;
        if (2 * __popc(__ballot_sync(ALL, ready)) < __popc(__ballot_sync(ALL, open)) &&
            !__any_sync(ALL, urgent))
          break;
        // Of hits at the same distance, the first of the list.
        float others[LANES];
        bool tie = next && second <= t;
        for (int i = 1; i < LANES; i++) {
          others[i] = __shfl_xor_sync(ALL, next ? t : INFINITE, i);
          tie = tie || (next && others[i] == t);
        }
        if (LANES > 1 && __any_sync(ALL, tie)) {
          int least = least_of_ray(next && t == nearest ? pending.place[0] : 0x7fffffff);
          next = next && t == nearest && pending.place[0] == least;
          for (int i = 1; i < LANES; i++)
            others[i] = __shfl_xor_sync(ALL, next ? t : INFINITE, i);
        }
        float front = path.transmittance, clear = next ? 1 - pending.alpha[0] : 1;
        for (int i = 1; i < LANES; i++) {
          float other = __shfl_xor_sync(ALL, clear, i);
          if (others[i] < t) front *= other;
        }
        const bool blended = next && front > TRANSMITTANCE_MIN;
        const int id = blended ? list[pending.place[0]] : 0;
        Look hit;
        float added = 0;
        if (blended) {
          hit = look<BACK>(scene, ray, id, pending.alpha[0]);
          const float weight = front * hit.alpha;
          path.sum.x += weight * hit.seen.x;
          path.sum.y += weight * hit.seen.y;
          path.sum.z += weight * hit.seen.z;
          path.sum.w += weight * t;
          path.hits++;
          if (BACK)
            added = weight * (slope->g.x * hit.seen.x + slope->g.y * hit.seen.y +
                              slope->g.z * hit.seen.z + slope->g.w * t);
        }
        if (BACK) {
          float rest = slope->rest;
          for (int i = 1; i < LANES; i++) {
            float other = __shfl_xor_sync(ALL, added, i);
            if (others[i] < t) rest -= other;
          }
          if (blended) learn(scene, ray, id, t, hit, front, added, rest, slope);
          slope->rest -= sum_of_ray(added);
        }
        path.transmittance = least_of_ray(blended ? front * clear : path.transmittance);
        if (path.transmittance <= TRANSMITTANCE_MIN) open = live = false;
        pending.pop(next);
        if (next && reserve.count) reserve.move_to(pending);
      }
      if (pending.t[0] == INFINITE && limit.t == INFINITE) oldest = 0x7fffffff;
      if (end.t < bar) open = false;
      if (last || !__any_sync(ALL, open)) break;
      __syncwarp();
      first += 32;
      have -= 32;
      turned ^= 1;
      fill();
    }
    arrive();
    floor = least_of_ray(limit);
    live = live && floor.t < INFINITE;
    if (!__any_sync(ALL, live)) break;
    start = least_of_warp(live ? oldest : entries);
    limit = nothing;
    oldest = 0x7fffffff;
    pending.clear();
    reserve.count = 0;
  }
}

// What a lane of the march works on.
struct Job {
  size_t group, ray;
  int sample, part;
  bool there;
};

__device__ __forceinline__ Job job_of(const int *turn) {
  const int lane = threadIdx.x & 31;
  const size_t warp = (size_t)blockIdx.x * WARPS + (threadIdx.x >> 5);
  Job job;
  job.group = turn[warp / (SAMPLES * PER)];
  job.part = warp % PER;
  const int slot = slot_of(job.part, lane / LANES);
  job.sample = warp / PER % SAMPLES;
  job.ray = (size_t)job.sample * RAYS + job.group * GROUP + slot;
  job.there = slot < GROUP;
  return job;
}

__device__ __forceinline__ Ray ray_at(const float *origin, const float *direction,
                                      const float4 *weight, const float *time, size_t i,
                                      bool there) {
  Ray ray = {{0, 0, 0}, {0, 0, 0}, {1, 0, 0, 0}};
  if (there) {
    ray.o = load(origin, i);
    ray.d = load(direction, i);
    if (KEYS > 1) ray.weight = weight[i];
#if TRANSIENT
    ray.time = time[i];
#endif
  }
  return ray;
}

extern "C" __global__ void __launch_bounds__(32 * WARPS, KEYS == 1 && K <= 8 ? 5 : 1)
forward(const float *origin, const float *direction, const float4 *weight, const float *time,
        const int *list, const float *bounds, const u32 *words, const int *count, const int *turn,
        const float4 *state, const float4 *keyed, const float *color, const float4 *window,
        float4 *sum, float *transmittance, int *hits) {
  if ((size_t)blockIdx.x * WARPS + (threadIdx.x >> 5) >= JOBS) return;
  const Job job = job_of(turn);
  const Ray ray = ray_at(origin, direction, weight, time, job.ray, job.there);
  Path path = {{0, 0, 0, 0}, 1, 0};
  const Scene scene = {state, keyed, color, window};
  march<false>(scene, list, bounds, words, count, job.group, job.sample, job.part, ray, path,
               nullptr);
  float4 total = {sum_of_ray(path.sum.x), sum_of_ray(path.sum.y), sum_of_ray(path.sum.z),
                  sum_of_ray(path.sum.w)};
  int met = (int)sum_of_ray((float)path.hits);
  if (!job.there || threadIdx.x % LANES) return;
  sum[job.ray] = total;
  transmittance[job.ray] = path.transmittance;
  hits[job.ray] = met;
}

// The gradients of the Gaussians are added to what `d_state`, `d_color`, `d_keyed` and `d_window`
// hold.
extern "C" __global__ void __launch_bounds__(32 * WARPS)
backward(const float *origin, const float *direction, const float4 *weight, const float *time,
         const int *list, const float *bounds, const u32 *words, const int *count, const int *turn,
         const float4 *state, const float4 *keyed, const float *color, const float4 *window,
         const float4 *sum, const float *transmittance, const float4 *g_sum,
         const float *g_transmittance, float *d_state, float *d_color, float *d_keyed,
         float *d_window, float *d_origin, float *d_direction, float4 *d_weight, float *d_time) {
  if ((size_t)blockIdx.x * WARPS + (threadIdx.x >> 5) >= JOBS) return;
  const Job job = job_of(turn);
  const Ray ray = ray_at(origin, direction, weight, time, job.ray, job.there);
  Path path = {{0, 0, 0, 0}, 1, 0};
  Slope slope = {};
  slope.state = d_state;
  slope.color = d_color;
  slope.keyed = d_keyed;
#if TRANSIENT
  slope.window = d_window;
#endif
  if (job.there) {
    float4 total = sum[job.ray], g = g_sum[job.ray];
    slope.g = g;
    slope.rest = g.x * total.x + g.y * total.y + g.z * total.z + g.w * total.w +
                 g_transmittance[job.ray] * transmittance[job.ray];
  }
  const Scene scene = {state, keyed, color, window};
  march<true>(scene, list, bounds, words, count, job.group, job.sample, job.part, ray, path,
              &slope);
  Vector o = slope.d_origin, d = slope.d_direction, w = slope.d_weight;
  o = {sum_of_ray(o.x), sum_of_ray(o.y), sum_of_ray(o.z)};
  d = {sum_of_ray(d.x), sum_of_ray(d.y), sum_of_ray(d.z)};
  w = {sum_of_ray(w.x), sum_of_ray(w.y), sum_of_ray(w.z)};
#if TRANSIENT
  const float moment = sum_of_ray(slope.d_time);
#endif
  if (!job.there || threadIdx.x % LANES) return;
  store(d_origin, job.ray, o);
  store(d_direction, job.ray, d);
  if (KEYS > 1) d_weight[job.ray] = {w.x, w.y, w.z, 0};
#if TRANSIENT
  d_time[job.ray] = moment;
#endif
}
