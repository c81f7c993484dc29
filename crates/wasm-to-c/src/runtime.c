typedef uint32_t u32;
typedef uint64_t u64;
typedef int8_t i8;
typedef int16_t i16;
typedef int32_t i32;
typedef int64_t i64;
typedef float f32;
typedef double f64;

static inline f32 f32_from_bits(u32 bits) {
    f32 x;
    memcpy(&x, &bits, sizeof x);
    return x;
}

static inline f64 f64_from_bits(u64 bits) {
    f64 x;
    memcpy(&x, &bits, sizeof x);
    return x;
}

static inline u32 f32_bits(f32 x) {
    u32 bits;
    memcpy(&bits, &x, sizeof bits);
    return bits;
}

static inline u64 f64_bits(f64 x) {
    u64 bits;
    memcpy(&bits, &x, sizeof bits);
    return bits;
}

static inline u32 load_u8(const Model *m, u32 address, u32 offset) {
    return *(m->memory + address + offset);
}
#define U8(address, offset) load_u8(m, address, offset)

static inline u32 load_u16(const Model *m, u32 address, u32 offset) {
    const uint8_t *p = m->memory + address + offset;
#ifdef LITTLE_ENDIAN_MEMORY
    uint16_t x;
    memcpy(&x, p, sizeof x);
    return x;
#else
    return p[0] | (u32)p[1] << 8;
#endif
}
#define U16(address, offset) load_u16(m, address, offset)

static inline u32 load_u32(const Model *m, u32 address, u32 offset) {
    const uint8_t *p = m->memory + address + offset;
#ifdef LITTLE_ENDIAN_MEMORY
    u32 x;
    memcpy(&x, p, sizeof x);
    return x;
#else
    return p[0] | (u32)p[1] << 8 | (u32)p[2] << 16 | (u32)p[3] << 24;
#endif
}
#define U32(address, offset) load_u32(m, address, offset)

static inline u64 load_u64(const Model *m, u32 address, u32 offset) {
    const uint8_t *p = m->memory + address + offset;
#ifdef LITTLE_ENDIAN_MEMORY
    u64 x;
    memcpy(&x, p, sizeof x);
    return x;
#else
    return p[0] | (u64)p[1] << 8 | (u64)p[2] << 16 | (u64)p[3] << 24 | (u64)p[4] << 32 | (u64)p[5] << 40
        | (u64)p[6] << 48 | (u64)p[7] << 56;
#endif
}
#define U64(address, offset) load_u64(m, address, offset)

static inline f32 load_f32(const Model *m, u32 address, u32 offset) {
    return f32_from_bits(load_u32(m, address, offset));
}
#define F32(address, offset) load_f32(m, address, offset)

static inline f64 load_f64(const Model *m, u32 address, u32 offset) {
    return f64_from_bits(load_u64(m, address, offset));
}
#define F64(address, offset) load_f64(m, address, offset)

static inline void store_u8(Model *m, u32 address, u32 offset, u32 x) {
    *(m->memory + address + offset) = (uint8_t)x;
}
#define SET_U8(address, offset, x) store_u8(m, address, offset, x)

static inline void store_u16(Model *m, u32 address, u32 offset, u32 x) {
    uint8_t *p = m->memory + address + offset;
#ifdef LITTLE_ENDIAN_MEMORY
    uint16_t low = (uint16_t)x;
    memcpy(p, &low, sizeof low);
#else
    p[0] = (uint8_t)x;
    p[1] = (uint8_t)(x >> 8);
#endif
}
#define SET_U16(address, offset, x) store_u16(m, address, offset, x)

static inline void store_u32(Model *m, u32 address, u32 offset, u32 x) {
    uint8_t *p = m->memory + address + offset;
#ifdef LITTLE_ENDIAN_MEMORY
    memcpy(p, &x, sizeof x);
#else
    p[0] = (uint8_t)x;
    p[1] = (uint8_t)(x >> 8);
    p[2] = (uint8_t)(x >> 16);
    p[3] = (uint8_t)(x >> 24);
#endif
}
#define SET_U32(address, offset, x) store_u32(m, address, offset, x)

static inline void store_u64(Model *m, u32 address, u32 offset, u64 x) {
    uint8_t *p = m->memory + address + offset;
#ifdef LITTLE_ENDIAN_MEMORY
    memcpy(p, &x, sizeof x);
#else
    int i;
    for (i = 0; i < 8; i++)
        p[i] = (uint8_t)(x >> 8 * i);
#endif
}
#define SET_U64(address, offset, x) store_u64(m, address, offset, x)

static inline void store_f32(Model *m, u32 address, u32 offset, f32 x) {
    store_u32(m, address, offset, f32_bits(x));
}
#define SET_F32(address, offset, x) store_f32(m, address, offset, x)

static inline void store_f64(Model *m, u32 address, u32 offset, f64 x) {
    store_u64(m, address, offset, f64_bits(x));
}
#define SET_F64(address, offset, x) store_f64(m, address, offset, x)

/* Whether `n` bytes are in memory from the address on. */
static inline int is_inside(u32 address, u32 n) {
    return n <= MODEL_MEMORY_SIZE && address <= MODEL_MEMORY_SIZE - n;
}

/* Copies bytes, or fills memory with a byte; nothing happens if they are not inside. */
static inline int memory_copy(Model *m, u32 to, u32 from, u32 size) {
    if (!is_inside(to, size) || !is_inside(from, size))
        return 0;
    memmove(m->memory + to, m->memory + from, size);
    return 1;
}
#define COPY(to, from, size) \
    if (!memory_copy(m, to, from, size)) goto out_of_bounds

static inline int memory_fill(Model *m, u32 to, u32 byte, u32 size) {
    if (!is_inside(to, size))
        return 0;
    memset(m->memory + to, (int)(byte & 255), size);
    return 1;
}
#define FILL(to, byte, size) \
    if (!memory_fill(m, to, byte, size)) goto out_of_bounds

static inline u32 memory_grow(Model *m, u32 pages) {
    u32 before = m->pages;
    if (pages > MODEL_MEMORY_SIZE / 65536u - before)
        return UINT32_MAX;
    m->pages += pages;
    return before;
}

static inline u32 u32_rotate_left(u32 x, u32 by) {
    return x << (by & 31) | x >> (-by & 31);
}

static inline u32 u32_rotate_right(u32 x, u32 by) {
    return x >> (by & 31) | x << (-by & 31);
}

static inline u64 u64_rotate_left(u64 x, u64 by) {
    return x << (by & 63) | x >> (-by & 63);
}

static inline u64 u64_rotate_right(u64 x, u64 by) {
    return x >> (by & 63) | x << (-by & 63);
}

static inline u32 u32_leading_zeros(u32 x) {
#ifdef __GNUC__
    return x ? (u32)__builtin_clzl(x) - (u32)(8 * sizeof(long) - 32) : 32;
#else
    u32 n = 32;
    for (; x; x >>= 1)
        n--;
    return n;
#endif
}

static inline u64 u64_leading_zeros(u64 x) {
#ifdef __GNUC__
    return x ? (u64)__builtin_clzll(x) : 64;
#else
    u64 n = 64;
    for (; x; x >>= 1)
        n--;
    return n;
#endif
}

static inline u32 u32_ones(u32 x) {
    x -= x >> 1 & 0x55555555u;
    x = (x & 0x33333333u) + (x >> 2 & 0x33333333u);
    return ((x + (x >> 4)) & 0x0f0f0f0fu) * 0x01010101u >> 24;
}

static inline u64 u64_ones(u64 x) {
    return (u64)u32_ones((u32)x) + u32_ones((u32)(x >> 32));
}

static inline u32 u32_trailing_zeros(u32 x) {
    return u32_ones((x & -x) - 1);
}

static inline u64 u64_trailing_zeros(u64 x) {
    return u64_ones((x & -x) - 1);
}

static inline u32 i32_remainder(u32 x, u32 y) {
    return y == UINT32_MAX ? 0 : (u32)((i32)x % (i32)y);
}

static inline u64 i64_remainder(u64 x, u64 y) {
    return y == UINT64_MAX ? 0 : (u64)((i64)x % (i64)y);
}

static inline int f64_is_finite(f64 x) {
    return (f64_bits(x) & 0x7fffffffffffffffu) < 0x7ff0000000000000u;
}

static inline f32 f32_min(f32 x, f32 y) {
    if (x != x || y != y)
        return x + y;
    return x < y || (x == y && signbit(x)) ? x : y;
}

static inline f32 f32_max(f32 x, f32 y) {
    if (x != x || y != y)
        return x + y;
    return x > y || (x == y && !signbit(x)) ? x : y;
}

static inline f64 f64_min(f64 x, f64 y) {
    if (x != x || y != y)
        return x + y;
    return x < y || (x == y && signbit(x)) ? x : y;
}

static inline f64 f64_max(f64 x, f64 y) {
    if (x != x || y != y)
        return x + y;
    return x > y || (x == y && !signbit(x)) ? x : y;
}

/* Conversions of what may be out of range go to the closest number, and of NaN to zero. */
static inline u32 i32_saturated(f64 x) {
    return x != x ? 0 : x <= -2147483648.0 ? 0x80000000u : x >= 2147483647.0 ? 0x7fffffffu : (u32)(i32)x;
}

static inline u32 u32_saturated(f64 x) {
    return x >= 4294967295.0 ? 0xffffffffu : x > -1.0 ? (u32)x : 0;
}

static inline u64 i64_saturated(f64 x) {
    return x != x ? 0
        : x < -9223372036854775808.0 ? 0x8000000000000000u
        : x >= 9223372036854775808.0 ? 0x7fffffffffffffffu
        : (u64)(i64)x;
}

static inline u64 u64_saturated(f64 x) {
    return x >= 18446744073709551616.0 ? 0xffffffffffffffffu : x > -1.0 ? (u64)x : 0;
}
