/* Stiffness of some integration points of a cell (rk_gradient), compiled for several kinds of
   processor: the one at hand is found when the library is loaded. */
#include <stdint.h>

#if defined(__x86_64__) && defined(__linux__) && defined(__GNUC__) && !defined(__clang__)
#define EACH_PROCESSOR __attribute__((target_clones("default", "fma")))
#else
#define EACH_PROCESSOR
#endif
#define INLINE static inline __attribute__((always_inline))

/* Source points are stored in fours, padded with zeros to a multiple of LINE; blocks of 3 x 3 x 3
   moduli take MODULI numbers, including those that the last four reads beyond their end */
enum { WIDE = 4, LINE = 8, MODULI = 32 };
typedef double four __attribute__((vector_size(32), aligned(8)));

/* Data of the points; counts known to the compiler are passed as separate arguments */
typedef struct {
   int points, sources, padded; /* integration points, source points that they see, those padded */
   const double *restrict s;    /* integration points, their source points, those padded */
   const double *restrict c;    /* moduli C(i, a, j, b), shape (MODULI of (i, a, j), nd, points) */
   double *restrict right;      /* room, shape (MODULI of (i, a, j), points) */
   const int *restrict to;      /* rows of the part before each source point's, ascending */
} points_type;

/* right(i, a, j) of each point = sum over b of C(i, a, j, b) S_j(l, b); where gradients differ,
   fours of the next j overwrite the end of this one */
INLINE void contract(const int fields, const int nd, const int kinds, const points_type *p, int l)
{
   const int length = kinds > 1 ? fields * nd : fields * fields * nd;
   const long kind = (long)p->padded * nd * p->points;
   for (int q = 0; q < p->points; q++) {
#pragma GCC unroll 3
      for (int j = 0; j < kinds; j++) {
         const double *s = p->s + j * kind + (long)nd * q * p->padded + l;
         const double *c = p->c + (long)MODULI * nd * q + j * length;
         double *right = p->right + (long)MODULI * q + j * length;
#pragma GCC unroll 7
         for (int x = 0; x < length; x += WIDE) {
            four sum = {0.0};
#pragma GCC unroll 3
            for (int b = 0; b < nd; b++)
               sum += *(const four *)(c + MODULI * b + x) * s[(long)b * p->padded];
            *(four *)(right + x) = sum;
         }
      }
   }
}

/* column(to(k) + i) += sum(i) of four source points, of which there are `many` */
INLINE void scatter(const int fields, const four *sum, const int *to, int many, double *column)
{
   four mixed[3] = {sum[0]};
   if (fields == 3) {
      const four a = __builtin_shufflevector(sum[0], sum[1], 0, 4, 0, 1);
      const four b = __builtin_shufflevector(sum[0], sum[1], 5, 0, 2, 6);
      const four c = __builtin_shufflevector(sum[0], sum[1], 0, 3, 7, 0);
      mixed[0] = __builtin_shufflevector(a, sum[2], 0, 1, 4, 3);
      mixed[1] = __builtin_shufflevector(b, sum[2], 0, 5, 2, 3);
      mixed[2] = __builtin_shufflevector(c, sum[2], 6, 1, 2, 7);
   } else if (fields == 2) {
      mixed[0] = __builtin_shufflevector(sum[0], sum[1], 0, 4, 1, 5);
      mixed[1] = __builtin_shufflevector(sum[0], sum[1], 2, 6, 3, 7);
   }
   /* neighbours on a lattice are consecutive */
   if (many >= WIDE && to[WIDE - 1] - to[0] == fields * (WIDE - 1)) {
#pragma GCC unroll 3
      for (int x = 0; x < fields; x++) *(four *)(column + to[0] + WIDE * x) += mixed[x];
      return;
   }
   const double *from = (const double *)mixed;
   for (int v = 0; v < many && v < WIDE; v++)
#pragma GCC unroll 3
      for (int i = 0; i < fields; i++) column[to[v] + i] += from[fields * v + i];
}

/* Blocks K(i, j) of all pairs k <= l; enough independent sums to hide the latency of one */
INLINE void add_pairs(const int fields, const int nd, const int kinds, const points_type *p, int rows,
                      double *restrict part)
{
   const int beside = fields == 3 ? 1 : 2;
   const long kind = (long)p->padded * nd * p->points;
   for (int l = 0; l < p->sources; l++) {
      contract(fields, nd, kinds, p, l);
      for (int k = 0; k <= l; k += WIDE * beside) {
         four sum[2][9];
#pragma GCC unroll 2
         for (int u = 0; u < beside; u++)
#pragma GCC unroll 9
            for (int x = 0; x < fields * fields; x++) sum[u][x] = (four){0.0};
         for (int q = 0; q < p->points; q++) {
            const double *from = p->s + (long)nd * q * p->padded + k;
            const double *with = p->right + (long)MODULI * q;
#pragma GCC unroll 3
            for (int a = 0; a < nd; a++, from += p->padded, with += fields)
#pragma GCC unroll 3
               for (int i = 0; i < fields; i++)
#pragma GCC unroll 2
                  for (int u = 0; u < beside; u++) {
                     const four left = *(const four *)(from + WIDE * u + (kinds > 1 ? i * kind : 0));
#pragma GCC unroll 3
                     for (int j = 0; j < fields; j++)
                        sum[u][fields * j + i] += left * with[fields * nd * j + i];
                  }
         }
#pragma GCC unroll 2
         for (int u = 0; u < beside; u++)
#pragma GCC unroll 3
            for (int j = 0; j < fields; j++)
               scatter(fields, sum[u] + fields * j, p->to + k + WIDE * u, p->sources - k - WIDE * u,
                       part + (long)rows * (p->to[l] + j));
      }
   }
}

/* Add the stiffness of `points` integration points: blocks
      K(i, j)(k, l) = sum over points, a and b of S_i(k, a) C(i, a, j, b) S_j(l, b),
   where S_i are the gradients of component i of the shape functions. Blocks of pairs k <= l count,
   others have no meaning.
      start, local, first, value   those of rk_gradient, from these points on
      c4                           moduli times weight, shape (3, 3, 3, 3, points)
      members                      source points of the group; the part has fields*members rows
      room                         as many numbers as rk_stiffness_room says */
EACH_PROCESSOR
void rk_add_stiffness(int fields, int nd, int points, const int64_t *restrict start,
                      const int *restrict local, const int64_t *restrict first,
                      const double *restrict value, const double *restrict c4, int members,
                      double *restrict room, double *restrict part)
{
   points_type p = {.points = points};
   int *place = (int *)room, *to = place + members, kinds = 1;

   for (int k = 0; k < members; k++) place[k] = -1;
   for (int64_t e = start[0]; e < start[points]; e++) place[local[e] - 1] = 0;
   for (int k = 0; k < members; k++) {
      if (place[k] < 0) continue;
      to[p.sources] = fields * k;
      place[k] = p.sources++;
   }
   p.to = to;
   p.padded = (p.sources + LINE - 1) / LINE * LINE;
   for (int q = 0; q < points; q++)
      if (first[fields * q] != first[fields * q + fields - 1]) kinds = fields;
   /* aligned to a cache line: fours that lie in two lines take twice as long */
   double *next = (double *)(((uintptr_t)(room + members) + 63) / 64 * 64);
   p.s = next;
   for (long x = 0; x < (long)p.padded * nd * points * kinds; x++) next[x] = 0.0;
   for (int i = 0; i < kinds; i++) {
      for (int q = 0; q < points; q++, next += (long)p.padded * nd) {
         const double *from = value + nd * first[fields * q + i];
         for (int64_t e = start[q]; e < start[q + 1]; e++, from += nd)
            for (int a = 0; a < nd; a++) next[a * p.padded + place[local[e] - 1]] = from[a];
      }
   }
   p.c = next;
   for (int q = 0; q < points; q++)
      for (int b = 0; b < nd; b++, next += MODULI) {
         for (int x = nd * fields * fields; x < MODULI; x++) next[x] = 0.0;
         for (int j = 0; j < fields; j++)
            for (int a = 0; a < nd; a++)
               for (int i = 0; i < fields; i++)
                  next[(j * nd + a) * fields + i] = c4[81L * q + i + 3 * a + 9 * j + 27 * b];
      }
   p.right = next;
   const int rows = fields * members;
   /* displacements have a component for each direction; other fields are scalars */
   if (fields == 3 && kinds == 1) add_pairs(3, 3, 1, &p, rows, part);
   else if (fields == 3) add_pairs(3, 3, 3, &p, rows, part);
   else if (fields == 2 && kinds == 1) add_pairs(2, 2, 1, &p, rows, part);
   else if (fields == 2) add_pairs(2, 2, 2, &p, rows, part);
   else add_pairs(1, nd, 1, &p, rows, part);
}

/* Size of the work array for the stiffness of `points` points and `members` source points */
int64_t rk_stiffness_room(int fields, int nd, int points, int members)
{
   return members + LINE + (int64_t)points * (nd * fields * (members + LINE) + MODULI * (nd + 1)) + MODULI;
}
