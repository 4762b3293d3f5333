/* Copyright 2026 The rigid_body_ros developers

   Licensed under the Apache License, Version 2.0 (the "License");
   you may not use this file except in compliance with the License.
   You may obtain a copy of the License at

       http://www.apache.org/licenses/LICENSE-2.0

   Unless required by applicable law or agreed to in writing, software
   distributed under the License is distributed on an "AS IS" BASIS,
   WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
   See the License for the specific language governing permissions and
   limitations under the License. */

/* What translated kernels build on: None, arrays, Python's arithmetic, lanes and four doubles.
   Everything is inlined, so that a compiler keeps the parts of tuples in registers. A unit is
   compiled with LANES, the number of bodies in a step. */

#pragma once
#include <stdint.h>
#include <type_traits>
#include <utility>
#if defined(__x86_64__)
#include <immintrin.h>
#endif

#define INLINED [[gnu::always_inline]] inline
#define FOLDED __attribute__((always_inline))

// Without an instruction, each fma is a call of the C library: it stays out of line.
#if defined(__FMA__) || defined(__aarch64__)
#define BY_LIBRARY INLINED
#else
#define BY_LIBRARY [[gnu::noinline]] inline
#endif

// A leaf of the arguments, as in boundary.c, and the name of a kernel at a level.
struct Slot {
  void *data;
  int64_t shape[4];
};
#define JOIN(name, suffix) name##suffix
#define JOIN_EXPANDED(name, suffix) JOIN(name, suffix)
#define KERNEL(name) JOIN_EXPANDED(name, SUFFIX)

// Each level has functions of its own.
namespace {
namespace py {

// None, which is known when a kernel is compiled. So are the dimensions of an array.

struct None {};
template <class T> using Bare = std::remove_cvref_t<T>;
template <class T> constexpr bool is_none = std::is_same_v<Bare<T>, None>;
template <class T> constexpr bool has_lanes = Bare<T>::dimensions == 2;
template <class T> concept Number = std::is_arithmetic_v<T>;
INLINED bool truth(bool condition) { return condition; }
bool truth(Number auto) = delete;  // in Python, `a and b` of numbers is a number

// Arrays: a view of contiguous memory, or of a column of it. A record is a structure of references.

constexpr int64_t END = INT64_MAX;

template <class T> concept Record = requires { T::record_size; };
template <class T> struct Element { typedef T Stored; static constexpr int64_t size = 1; };
template <Record T> struct Element<T> {
  typedef char Stored;
  static constexpr int64_t size = T::record_size;
};

template <int N> struct Sizes {
  int64_t of[N];
  INLINED constexpr int64_t &operator[](int k) { return of[k]; }
  INLINED constexpr int64_t operator[](int k) const { return of[k]; }
};
template <class T, int N> struct Array {
  static constexpr int dimensions = N;
  typename Element<T>::Stored *data;
  Sizes<N> shape;
  INLINED T *begin() const requires(N == 1) { return data; }
  INLINED T *end() const requires(N == 1) { return data + shape[0]; }
};
template <class T> struct Column {
  T *data;
  Sizes<1> shape;
  int64_t stride;
};

template <class T, int N> INLINED int64_t length(const Array<T, N> &a) { return a.shape[0]; }

// Unlike in Python, an index is not negative; a debugging build checks it.
INLINED void check(int64_t k, int64_t size) {
#if defined(CHECK_INDICES)
  if (k < 0 || k >= size) __builtin_trap();
#endif
}
template <class T, int N> INLINED decltype(auto) at(const Array<T, N> &a, int64_t k) {
  check(k, a.shape[0]);
  if constexpr (N > 1) {
    Array<T, N - 1> row{a.data, {}};
    int64_t size = Element<T>::size;
    for (int d = 0; d < N - 1; d++) size *= row.shape[d] = a.shape[d + 1];
    row.data += k * size;
    return row;
  } else if constexpr (Record<T>) {
    return T(a.data + k * T::record_size);
  } else {
    return (a.data[k]);
  }
}
template <class T> INLINED T &at(const Column<T> &a, int64_t k) {
  check(k, a.shape[0]);
  return a.data[k * a.stride];
}
template <class A> INLINED decltype(auto) at(const A &a, int64_t k, Number auto... rest) {
  return at(at(a, k), int64_t(rest)...);
}
template <int K, class T, int N> INLINED decltype(auto) at(const Array<T, N> &a) {
  return at(a, K);
}
template <int K, class T> INLINED T &at(const Column<T> &a) { return at(a, K); }
template <int K, int N> INLINED int64_t at(const Sizes<N> &shape) { return shape[K]; }

INLINED int64_t limited(int64_t k, int64_t size) {
  k = k < 0 ? k + size : k;
  return k < 0 ? 0 : k < size ? k : size;
}
template <class T, int N> INLINED auto slice(Array<T, N> a, int64_t begin, int64_t end) {
  begin = limited(begin, a.shape[0]);
  int64_t count = limited(end, a.shape[0]) - begin, size = Element<T>::size;
  a.shape[0] = count < 0 ? 0 : count;
  for (int d = 1; d < N; d++) size *= a.shape[d];
  a.data += begin * size;
  return a;
}
template <int64_t BEGIN, int64_t STOP, class T, int N> INLINED auto slice(const Array<T, N> &a) {
  return slice(a, BEGIN, STOP);
}
template <class T> INLINED Column<T> column(const Array<T, 2> &a, int64_t k) {
  return {a.data + k, {a.shape[0]}, a.shape[1]};
}

// Tuples. The translator writes the structures of tuples of each size and of named tuples.

template <class... T> struct Tuple;
template <class... T> Tuple(T...) -> Tuple<T...>;
template <class... T> INLINED auto tuple(const T &...parts) { return Tuple<T...>{parts...}; }
template <class T> concept Parts = requires { T::count; };
template <int K, Parts T> INLINED const auto &at(const T &parts) {
  return parts.template part<K>();
}
template <Parts T> INLINED constexpr int64_t length(const T &) { return T::count; }
template <Parts T> INLINED auto at(const T &parts, int64_t k) {
  auto found = at<0>(parts);
  [&]<int... K>(std::integer_sequence<int, K...>) FOLDED {
    ((found = k == K + 1 ? at<K + 1>(parts) : found), ...);
  }(std::make_integer_sequence<int, T::count - 1>());
  return found;
}
template <int64_t BEGIN, int64_t STOP, Parts T> INLINED auto slice(const T &parts) {
  constexpr int64_t end = STOP < 0 ? STOP + T::count : STOP < T::count ? STOP : T::count;
  return [&]<int... K>(std::integer_sequence<int, K...>) FOLDED {
    return tuple(at<BEGIN + K>(parts)...);
  }(std::make_integer_sequence<int, end - BEGIN>());
}
// The same for an argument: copies of many lanes would not stay in registers.
template <int64_t BEGIN, int64_t STOP, Parts T> INLINED auto lent(const T &parts) {
  constexpr int64_t end = STOP < 0 ? STOP + T::count : STOP < T::count ? STOP : T::count;
  return [&]<int... K>(std::integer_sequence<int, K...>) FOLDED {
    return Tuple<decltype(at<BEGIN + K>(parts))...>{at<BEGIN + K>(parts)...};
  }(std::make_integer_sequence<int, end - BEGIN>());
}
template <int64_t BEGIN, int64_t STOP, class T, int N> INLINED auto lent(const Array<T, N> &a) {
  return slice(a, BEGIN, STOP);
}
// Call a function with the parts of a tuple.
template <class F, Parts T> INLINED auto apply(F f, const T &parts) {
  return [&]<int... K>(std::integer_sequence<int, K...>) FOLDED {
    return f(at<K>(parts)...);
  }(std::make_integer_sequence<int, T::count>());
}
template <Parts A, Parts B> INLINED auto operator+(const A &a, const B &b) {
  return apply([&](const auto &...first) FOLDED {
    return apply([&](const auto &...rest) FOLDED { return tuple(first..., rest...); }, b);
  }, a);
}
// What a loop goes through.
template <class T, int N> struct Elements {
  T values[N];
  INLINED const T *begin() const { return values; }
  INLINED const T *end() const { return values + N; }
};
template <class T> INLINED const Array<T, 1> &elements(const Array<T, 1> &a) { return a; }
template <Parts T> INLINED auto elements(const T &parts) {
  return apply([](const auto &first, const auto &...rest) FOLDED {
    return Elements<Bare<decltype(first)>, T::count>{{first, rest...}};
  }, parts);
}

// Python's arithmetic. Infinities and NaNs come where Python would raise an error.

template <class A, class B> INLINED auto quotient(A a, B b) {
  if constexpr (Number<A> && Number<B>) return double(a) / double(b);
  else return a / b;
}
INLINED bool is_known_power_of_two(int64_t b) {
  return __builtin_constant_p(b) && b > 0 && (b & (b - 1)) == 0;
}
INLINED int64_t floor_quotient(int64_t a, int64_t b) {
  if (is_known_power_of_two(b)) return a >> __builtin_ctzll(b);
  return a / b - (a % b != 0 && (a < 0) != (b < 0));
}
INLINED int64_t modulo(int64_t a, int64_t b) {
  if (is_known_power_of_two(b)) return a & (b - 1);
  int64_t rest = a % b;
  return rest != 0 && (rest < 0) != (b < 0) ? rest + b : rest;
}
INLINED double modulo(double a, double b) {
  double rest = __builtin_fmod(a, b);
  return rest != 0.0 && (rest < 0.0) != (b < 0.0) ? rest + b : rest;
}
INLINED bool in_range(int64_t k, int64_t end, int64_t step) { return step > 0 ? k < end : k > end; }
template <class A, class B, class... C> INLINED auto largest(A a, B b, C... c) {
  auto both = b > a ? b : a;
  if constexpr (sizeof...(C) == 0) return both;
  else return largest(both, c...);
}
template <class A, class B, class... C> INLINED auto least(A a, B b, C... c) {
  auto both = b < a ? b : a;
  if constexpr (sizeof...(C) == 0) return both;
  else return least(both, c...);
}
INLINED double absolute(double a) { return __builtin_fabs(a); }
INLINED int64_t absolute(int64_t a) { return a < 0 ? -a : a; }
INLINED double square_root(double a) { return __builtin_sqrt(a); }
INLINED double nearest(double a) { return __builtin_rint(a); }
INLINED int64_t rounded(double a) { return int64_t(__builtin_rint(a)); }
INLINED double floored(double a) { return __builtin_floor(a); }
INLINED int64_t floored_integer(double a) { return int64_t(__builtin_floor(a)); }
INLINED double with_sign(double a, double sign) { return __builtin_copysign(a, sign); }
INLINED double scaled(double a, int64_t power) { return __builtin_ldexp(a, int(power)); }
template <class T> INLINED int64_t places_right(const Array<T, 1> &sorted, T value) {
  int64_t first = 0, last = sorted.shape[0];
  while (first < last) {
    int64_t middle = first + (last - first) / 2;
    if (value < sorted.data[middle]) last = middle;
    else first = middle + 1;
  }
  return first;
}

// Registers.

template <int N> struct Register { typedef double Doubles __attribute__((vector_size(8 * N))); };
typedef Register<4>::Doubles FourDoubles;
typedef Register<LANES>::Doubles LaneDoubles;
typedef int64_t FourBits __attribute__((vector_size(32)));
typedef int64_t LaneBits __attribute__((vector_size(8 * LANES)));

template <class R> BY_LIBRARY R fma_by_element(R a, R b, R c) {
  R result;
  for (unsigned k = 0; k < sizeof(R) / 8; k++) result[k] = __builtin_fma(a[k], b[k], c[k]);
  return result;
}
template <class R> INLINED R fma_registers(R a, R b, R c) {
#if defined(__AVX512F__)
  if constexpr (sizeof(R) == 64) return R(_mm512_fmadd_pd(__m512d(a), __m512d(b), __m512d(c)));
#endif
#if defined(__FMA__)
  if constexpr (sizeof(R) == 32) return R(_mm256_fmadd_pd(__m256d(a), __m256d(b), __m256d(c)));
#endif
  return fma_by_element(a, b, c);
}
// GCC 11 copies a structure in pieces, which cannot be forwarded from a store to a load.
template <class R> INLINED R load_register(const double *from) {
  typedef double Unaligned __attribute__((vector_size(sizeof(R)), aligned(8), may_alias));
  return *(const Unaligned *)from;
}
template <class R> INLINED void store_register(double *to, R value) {
  typedef double Unaligned __attribute__((vector_size(sizeof(R)), aligned(8), may_alias));
  *(Unaligned *)to = value;
}

// Lanes: a number of each of several bodies, and a condition in each.

struct Lanes { LaneDoubles v; };
#if defined(__AVX512F__)
#define IN_MASK_REGISTERS (LANES == 8)
#else
#define IN_MASK_REGISTERS 0
#endif
#if IN_MASK_REGISTERS  // GCC 11 does not use them by itself
struct Mask { __mmask8 v; };
#define MASK(a, sign, code) Mask{_mm512_cmp_pd_mask(__m512d(a.v), __m512d(b.v), code)}
#else
struct Mask { LaneBits v; };
#define MASK(a, sign, code) Mask{a.v sign b.v}
#endif

INLINED Lanes splat(double a) { return {a - LaneDoubles{}}; }  // a minus zero is a, even if it is -0
INLINED Lanes splat(Lanes a) { return a; }
#define IN_LANES(result, sign, expression)                                              \
  INLINED result operator sign(Lanes a, Lanes b) { return expression; }                 \
  INLINED result operator sign(Lanes a, double b) { return a sign splat(b); }           \
  INLINED result operator sign(double a, Lanes b) { return splat(a) sign b; }
IN_LANES(Lanes, +, Lanes{a.v + b.v})
IN_LANES(Lanes, -, Lanes{a.v - b.v})
IN_LANES(Lanes, *, Lanes{a.v * b.v})
IN_LANES(Lanes, /, Lanes{a.v / b.v})
IN_LANES(Mask, <, MASK(a, <, _CMP_LT_OQ))
IN_LANES(Mask, <=, MASK(a, <=, _CMP_LE_OQ))
IN_LANES(Mask, >, MASK(a, >, _CMP_GT_OQ))
IN_LANES(Mask, >=, MASK(a, >=, _CMP_GE_OQ))
INLINED Lanes operator-(Lanes a) { return {-a.v}; }

INLINED Lanes absolute(Lanes a) { return {LaneDoubles(LaneBits(a.v) & INT64_MAX)}; }
INLINED Lanes square_root(Lanes a) {
#if IN_MASK_REGISTERS
  return {LaneDoubles(_mm512_sqrt_pd(__m512d(a.v)))};
#else
  for (int k = 0; k < LANES; k++) a.v[k] = __builtin_sqrt(a.v[k]);
  return a;
#endif
}

}  // namespace py

namespace lanes {
using namespace py;
INLINED double fma(double a, double b, double c) { return __builtin_fma(a, b, c); }
template <class A, class B, class C> INLINED Lanes fma(A a, B b, C c) {
  return {fma_registers(splat(a).v, splat(b).v, splat(c).v)};
}
INLINED Lanes load(const Array<double, 2> &values, int64_t row) {
  check(row, values.shape[0]);
  return {load_register<LaneDoubles>(values.data + LANES * row)};
}
INLINED void store(const Array<double, 2> &values, int64_t row, Lanes numbers) {
  check(row, values.shape[0]);
  store_register(values.data + LANES * row, numbers.v);
}
INLINED void align_stack() {}  // compilers of C++ do
template <class T> INLINED T zero(const T &) { return T{}; }
INLINED int64_t no_count(double) { return 0; }
INLINED Lanes no_count(Lanes) { return Lanes{}; }
INLINED Lanes truncated(Lanes a) {
#if IN_MASK_REGISTERS
  return {LaneDoubles(_mm512_roundscale_pd(__m512d(a.v), _MM_FROUND_TO_ZERO | _MM_FROUND_NO_EXC))};
#else
  for (int k = 0; k < LANES; k++) a.v[k] = __builtin_trunc(a.v[k]);
  return a;
#endif
}
INLINED Lanes select(Mask condition, Lanes one, Lanes other) {
#if IN_MASK_REGISTERS
  return {LaneDoubles(_mm512_mask_blend_pd(condition.v, __m512d(other.v), __m512d(one.v)))};
#else
  return {condition.v ? one.v : other.v};
#endif
}
template <class A, class B> INLINED Lanes where(Mask condition, A one, B other) {
  return select(condition, splat(one), splat(other));
}
INLINED int64_t counted(bool condition, int64_t count) { return condition ? 0 : count + 1; }
INLINED Lanes counted(Mask condition, Lanes count) { return where(condition, 0.0, count + 1.0); }
INLINED bool both(bool one, bool other) { return one & other; }
INLINED Mask both(Mask one, Mask other) { return {decltype(one.v)(one.v & other.v)}; }
INLINED bool every(bool condition) { return condition; }
INLINED bool some(bool condition) { return condition; }
// Return a bit for each lane in which a condition holds.
INLINED unsigned bits(Mask condition) {
#if IN_MASK_REGISTERS
  return condition.v;
#elif defined(__AVX__)
  if constexpr (LANES == 4) return unsigned(_mm256_movemask_pd(__m256d(condition.v)));
#else
  unsigned found = 0;
  for (int k = 0; k < LANES; k++) found |= unsigned(condition.v[k] & 1) << k;
  return found;
#endif
}
INLINED bool every(Mask condition) { return bits(condition) == (1u << LANES) - 1; }
INLINED bool some(Mask condition) { return bits(condition) != 0; }
}  // namespace lanes

namespace py {

// Four doubles: in one register, or in a register of lanes each.

struct Four { FourDoubles v; };
struct FourLanes { Lanes v[4]; };

template <int K> INLINED double at(const Four &a) { return a.v[K]; }
template <int K> INLINED Lanes at(const FourLanes &a) { return a.v[K]; }
INLINED double at(const Four &a, int64_t k) { return a.v[k]; }
INLINED FourLanes spread(const FourLanes &a) { return a; }
INLINED FourLanes spread(const Four &a) {
  return {{splat(a.v[0]), splat(a.v[1]), splat(a.v[2]), splat(a.v[3])}};
}
// Apply a function of registers to all elements at once, or to the lanes of each.
template <class F, class... A> INLINED auto elementwise(F f, const A &...a) {
  if constexpr ((std::is_same_v<A, Four> && ...)) return Four{f(a.v...)};
  else return FourLanes{{{f(spread(a).v[0].v...)}, {f(spread(a).v[1].v...)},
                         {f(spread(a).v[2].v...)}, {f(spread(a).v[3].v...)}}};
}
// Reorder elements, and change the signs of some.
template <int I, int J, int K, int L> INLINED Four permuted(const Four &a) {
#if defined(__clang__)
  return {__builtin_shufflevector(a.v, a.v, I, J, K, L)};
#else
  return {__builtin_shuffle(a.v, FourBits{I, J, K, L})};
#endif
}
template <int I, int J, int K, int L> INLINED FourLanes permuted(const FourLanes &a) {
  return {{a.v[I], a.v[J], a.v[K], a.v[L]}};
}
template <bool I, bool J, bool K, bool L> INLINED Four flipped(const Four &a) {
  constexpr int64_t sign = INT64_MIN;
  return {FourDoubles(FourBits(a.v) ^ FourBits{sign * I, sign * J, sign * K, sign * L})};
}
template <bool I, bool J, bool K, bool L> INLINED FourLanes flipped(const FourLanes &a) {
  return {{I ? -a.v[0] : a.v[0], J ? -a.v[1] : a.v[1], K ? -a.v[2] : a.v[2],
           L ? -a.v[3] : a.v[3]}};
}

}  // namespace py

namespace four {
using namespace py;
INLINED Four of(double a, double b, double c, double d) { return {FourDoubles{a, b, c, d}}; }
template <class A, class B, class C, class D> INLINED FourLanes of(A a, B b, C c, D d) {
  return {{splat(a), splat(b), splat(c), splat(d)}};
}
INLINED auto broadcast(const auto &value) { return of(value, value, value, value); }
INLINED auto add(const auto &a, const auto &b) {
  return elementwise([](auto x, auto y) FOLDED { return x + y; }, a, b);
}
INLINED auto subtract(const auto &a, const auto &b) {
  return elementwise([](auto x, auto y) FOLDED { return x - y; }, a, b);
}
INLINED auto multiply(const auto &a, const auto &b) {
  return elementwise([](auto x, auto y) FOLDED { return x * y; }, a, b);
}
INLINED auto negative(const auto &a) {
  return elementwise([](auto x) FOLDED { return -x; }, a);
}
INLINED auto fma(const auto &a, const auto &b, const auto &c) {
  return elementwise([](auto x, auto y, auto z) FOLDED { return fma_registers(x, y, z); },
                     a, b, c);
}
INLINED Four absolute(const Four &a) { return {FourDoubles(FourBits(a.v) & INT64_MAX)}; }
INLINED FourLanes absolute(const FourLanes &a) {
  return {{py::absolute(a.v[0]), py::absolute(a.v[1]), py::absolute(a.v[2]), py::absolute(a.v[3])}};
}
INLINED auto yzx(const auto &a) { return permuted<1, 2, 0, 3>(a); }
INLINED auto zxy(const auto &a) { return permuted<2, 0, 1, 3>(a); }
INLINED auto times_i(const auto &q) { return flipped<0, 0, 1, 1>(permuted<3, 2, 1, 0>(q)); }
INLINED auto times_j(const auto &q) { return flipped<1, 0, 0, 1>(permuted<2, 3, 0, 1>(q)); }
INLINED auto times_k(const auto &q) { return flipped<0, 1, 0, 1>(permuted<1, 0, 3, 2>(q)); }
INLINED Four load(const Array<double, 1> &values, int64_t start) {
  check(start, values.shape[0] - 3);
  return {load_register<FourDoubles>(values.data + start)};
}
INLINED FourLanes load(const Array<double, 2> &values, int64_t row) {
  return {{lanes::load(values, row), lanes::load(values, row + 1), lanes::load(values, row + 2),
           lanes::load(values, row + 3)}};
}
INLINED void store(const Array<double, 1> &values, int64_t start, const Four &a) {
  check(start, values.shape[0] - 3);
  store_register(values.data + start, a.v);
}
INLINED void store(const Array<double, 2> &values, int64_t row, const auto &a) {
  for (int k = 0; k < 4; k++) lanes::store(values, row + k, spread(a).v[k]);
}
template <class T> INLINED T zero(const T &) { return T{}; }
INLINED Four choose(bool condition, const Four &one, const Four &other) {
  return condition ? one : other;
}
INLINED FourLanes choose(Mask condition, const auto &one, const auto &other) {
  FourLanes result;
  for (int k = 0; k < 4; k++)
    result.v[k] = lanes::select(condition, spread(one).v[k], spread(other).v[k]);
  return result;
}
}  // namespace four

namespace py {

// The arguments and the results of a kernel.

template <class T, int N> INLINED Array<T, N> array(const Slot &slot) {
  Array<T, N> result{(typename Element<T>::Stored *)slot.data, {}};
  for (int d = 0; d < N; d++) result.shape[d] = slot.shape[d];
  return result;
}
INLINED double number(const Slot &slot) {
  double result;
  __builtin_memcpy(&result, slot.shape, sizeof result);
  return result;
}
INLINED void store(int64_t *results, int64_t value) { *results = value; }
INLINED void store(int64_t *results, bool value) { *results = value; }
INLINED void store(int64_t *results, double value) {
  __builtin_memcpy(results, &value, sizeof value);
}
INLINED void store(int64_t *results, const Parts auto &values) {
  apply([&](const auto &...each) FOLDED { (store(results++, each), ...); }, values);
}

}  // namespace py
}  // namespace
