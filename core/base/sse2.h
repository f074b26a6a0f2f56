// SSE2's vectors of 128 bits, PPTAM_SSE2 where there are any: on x86-64 the compiler's, in WebAssembly with such
// vectors (-msimd128) those that the core uses, made of its own. So a loop is written by hand once for both. With
// PPTAM_PLAIN there are none.
//
// Every function gives the bits of Intel's, but for _mm_sad_epu8(), whose second argument must be zero.
#pragma once

#if defined(PPTAM_PLAIN)
#elif defined(__SSE2__)
#define PPTAM_SSE2
#include <emmintrin.h>
#elif defined(__wasm_simd128__)
#define PPTAM_SSE2
#include <wasm_simd128.h>

#include <cstdint>

namespace pptam {

using __m128i = v128_t;
using __m128 = v128_t;

// Memory. What is loaded may lie anywhere.
inline __m128i _mm_load_si128(const __m128i* from) {
  return wasm_v128_load(from);
}
inline __m128i _mm_loadu_si128(const __m128i* from) {
  return wasm_v128_load(from);
}
inline __m128i _mm_loadl_epi64(const __m128i* from) {
  return wasm_v128_load64_zero(from);
}
inline __m128 _mm_loadu_ps(const float* from) {
  return wasm_v128_load(from);
}
inline void _mm_store_si128(__m128i* to, __m128i v) {
  wasm_v128_store(to, v);
}
inline void _mm_storeu_si128(__m128i* to, __m128i v) {
  wasm_v128_store(to, v);
}
inline void _mm_storeu_ps(float* to, __m128 v) {
  wasm_v128_store(to, v);
}

// Numbers into vectors and back.
inline __m128i _mm_setzero_si128() {
  return wasm_i64x2_const(0, 0);
}
inline __m128i _mm_set1_epi8(char value) {
  return wasm_i8x16_splat(value);
}
inline __m128i _mm_set1_epi16(int16_t value) {
  return wasm_i16x8_splat(value);
}
inline __m128i _mm_set1_epi32(int32_t value) {
  return wasm_i32x4_splat(value);
}
inline __m128 _mm_set1_ps(float value) {
  return wasm_f32x4_splat(value);
}
inline __m128i _mm_set_epi32(int32_t d, int32_t c, int32_t b, int32_t a) {
  return wasm_i32x4_make(a, b, c, d);
}
inline __m128i _mm_cvtsi32_si128(int32_t value) {
  return wasm_i32x4_make(value, 0, 0, 0);
}
inline int32_t _mm_cvtsi128_si32(__m128i v) {
  return wasm_i32x4_extract_lane(v, 0);
}
inline int64_t _mm_cvtsi128_si64(__m128i v) {
  return wasm_i64x2_extract_lane(v, 0);
}
#define _mm_insert_epi16(v, value, lane) wasm_i16x8_replace_lane(v, lane, static_cast<int16_t>(value))

// Bits.
inline __m128i _mm_and_si128(__m128i a, __m128i b) {
  return wasm_v128_and(a, b);
}
inline __m128i _mm_or_si128(__m128i a, __m128i b) {
  return wasm_v128_or(a, b);
}
inline __m128i _mm_xor_si128(__m128i a, __m128i b) {
  return wasm_v128_xor(a, b);
}
inline __m128i _mm_slli_epi16(__m128i v, uint32_t bits) {
  return wasm_i16x8_shl(v, bits);
}
inline __m128i _mm_slli_epi32(__m128i v, uint32_t bits) {
  return wasm_i32x4_shl(v, bits);
}
inline __m128i _mm_srli_epi16(__m128i v, uint32_t bits) {
  return wasm_u16x8_shr(v, bits);
}
inline __m128i _mm_srli_epi32(__m128i v, uint32_t bits) {
  return wasm_u32x4_shr(v, bits);
}
inline __m128i _mm_srli_epi64(__m128i v, uint32_t bits) {
  return wasm_u64x2_shr(v, bits);
}
inline __m128i _mm_srai_epi32(__m128i v, uint32_t bits) {
  return wasm_i32x4_shr(v, bits);
}

// Arithmetic.
inline __m128i _mm_add_epi16(__m128i a, __m128i b) {
  return wasm_i16x8_add(a, b);
}
inline __m128i _mm_add_epi32(__m128i a, __m128i b) {
  return wasm_i32x4_add(a, b);
}
inline __m128i _mm_sub_epi16(__m128i a, __m128i b) {
  return wasm_i16x8_sub(a, b);
}
inline __m128i _mm_sub_epi32(__m128i a, __m128i b) {
  return wasm_i32x4_sub(a, b);
}
inline __m128i _mm_mullo_epi16(__m128i a, __m128i b) {
  return wasm_i16x8_mul(a, b);
}
inline __m128i _mm_madd_epi16(__m128i a, __m128i b) {
  return wasm_i32x4_dot_i16x8(a, b);
}
inline __m128i _mm_adds_epu8(__m128i a, __m128i b) {
  return wasm_u8x16_add_sat(a, b);
}
inline __m128i _mm_subs_epu8(__m128i a, __m128i b) {
  return wasm_u8x16_sub_sat(a, b);
}
inline __m128i _mm_max_epu8(__m128i a, __m128i b) {
  return wasm_u8x16_max(a, b);
}
inline __m128i _mm_min_epu8(__m128i a, __m128i b) {
  return wasm_u8x16_min(a, b);
}
inline __m128i _mm_cmpeq_epi8(__m128i a, __m128i b) {
  return wasm_i8x16_eq(a, b);
}
inline __m128i _mm_cmpgt_epi32(__m128i a, __m128i b) {
  return wasm_i32x4_gt(a, b);
}
inline int32_t _mm_movemask_epi8(__m128i v) {
  return static_cast<int32_t>(wasm_i8x16_bitmask(v));
}
inline __m128i _mm_sad_epu8(__m128i v, __m128i /*zero*/) {
  const __m128i fours = wasm_u32x4_extadd_pairwise_u16x8(wasm_u16x8_extadd_pairwise_u8x16(v));
  return wasm_v128_and(wasm_i32x4_add(fours, wasm_u64x2_shr(fours, 32)), wasm_i64x2_const_splat(0xffffffff));
}
inline __m128 _mm_add_ps(__m128 a, __m128 b) {
  return wasm_f32x4_add(a, b);
}
inline __m128 _mm_sub_ps(__m128 a, __m128 b) {
  return wasm_f32x4_sub(a, b);
}
inline __m128 _mm_mul_ps(__m128 a, __m128 b) {
  return wasm_f32x4_mul(a, b);
}

// Lanes in another order.
inline __m128i _mm_packs_epi32(__m128i a, __m128i b) {
  return wasm_i16x8_narrow_i32x4(a, b);
}
inline __m128i _mm_packus_epi16(__m128i a, __m128i b) {
  return wasm_u8x16_narrow_i16x8(a, b);
}
inline __m128i _mm_unpacklo_epi8(__m128i a, __m128i b) {
  return wasm_i8x16_shuffle(a, b, 0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21, 6, 22, 7, 23);
}
inline __m128i _mm_unpackhi_epi8(__m128i a, __m128i b) {
  return wasm_i8x16_shuffle(a, b, 8, 24, 9, 25, 10, 26, 11, 27, 12, 28, 13, 29, 14, 30, 15, 31);
}
inline __m128i _mm_unpacklo_epi16(__m128i a, __m128i b) {
  return wasm_i16x8_shuffle(a, b, 0, 8, 1, 9, 2, 10, 3, 11);
}
inline __m128i _mm_unpackhi_epi16(__m128i a, __m128i b) {
  return wasm_i16x8_shuffle(a, b, 4, 12, 5, 13, 6, 14, 7, 15);
}
inline __m128i _mm_unpacklo_epi32(__m128i a, __m128i b) {
  return wasm_i32x4_shuffle(a, b, 0, 4, 1, 5);
}
inline __m128i _mm_unpackhi_epi32(__m128i a, __m128i b) {
  return wasm_i32x4_shuffle(a, b, 2, 6, 3, 7);
}
inline __m128i _mm_unpacklo_epi64(__m128i a, __m128i b) {
  return wasm_i64x2_shuffle(a, b, 0, 2);
}
inline __m128i _mm_unpackhi_epi64(__m128i a, __m128i b) {
  return wasm_i64x2_shuffle(a, b, 1, 3);
}
#define _MM_SHUFFLE(d, c, b, a) ((d) << 6 | (c) << 4 | (b) << 2 | (a))
#define _mm_shuffle_epi32(v, order) \
  wasm_i32x4_shuffle(v, v, (order)&3, (order) >> 2 & 3, (order) >> 4 & 3, (order) >> 6 & 3)
#define _mm_shuffle_ps(a, b, order) \
  wasm_i32x4_shuffle(a, b, (order)&3, (order) >> 2 & 3, ((order) >> 4 & 3) + 4, ((order) >> 6 & 3) + 4)
// By whole bytes, zeros following.
#define PPTAM_FROM_BYTE(a, b, n)                                                                                     \
  wasm_i8x16_shuffle(a, b, (n) + 0, (n) + 1, (n) + 2, (n) + 3, (n) + 4, (n) + 5, (n) + 6, (n) + 7, (n) + 8, (n) + 9, \
                     (n) + 10, (n) + 11, (n) + 12, (n) + 13, (n) + 14, (n) + 15)
#define _mm_srli_si128(v, bytes) PPTAM_FROM_BYTE(v, _mm_setzero_si128(), bytes)
#define _mm_slli_si128(v, bytes) PPTAM_FROM_BYTE(_mm_setzero_si128(), v, 16 - (bytes))

}  // namespace pptam
#endif
