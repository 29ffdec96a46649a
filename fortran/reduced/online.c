/* Volume of a reduced model's states (rk_online), compiled for several kinds of processor, which
   the loader chooses from. */
#include <stdint.h>

#if defined(__x86_64__) && defined(__linux__) && defined(__GNUC__) && !defined(__clang__)
#define EACH_PROCESSOR __attribute__((target_clones("default", "avx2", "avx512f")))
#else
#define EACH_PROCESSOR
#endif

/* Energy of the changes of volume y = t(z, z, z) with z(0) = 1: pieces of 8 directions each, in which
   t has its entries l <= m <= n, l running first. Adds dy.y to the forces of z(1) .. z(s) and, where
   wanted, dy.dy + along.d2y to their stiffness up to the diagonal; `along` is set to y first if
   `restart` is set. `scale` has a factor on the energy of each piece; `room` is that for
   (s + 1)(s + 2)/2 + 1 vectors. */
EACH_PROCESSOR
void rk_online_volume(int pieces, int s, const double *restrict t, const double *restrict z,
                      const double *restrict scale, int tangent, int restart, double *restrict along, double *restrict y,
                      double *restrict dy, double *restrict room, double *restrict force,
                      double *restrict stiffness)
{
   const int count = s + 1, pairs = count * (count + 1) / 2;
   /* groups of eight are aligned with cache lines: the sums take a third longer otherwise */
   double *restrict pair = (double *)(((uintptr_t)room + 63) / 64 * 64);
   for (int piece = 0; piece < pieces; piece++, y += 8, along += 8, dy += 8L * s) {
      for (int i = 0; i < 8 * pairs; i++) pair[i] = 0.0;
      /* pair(l, m) = sum over n of t(l, m, n) z(n) */
      for (int n = 0; n < count; n++) {
         for (int m = 0; m <= n; m++) {
            double sum[8] = {0};
            double *lm = pair + 8L * (m * (m + 1) / 2), *ln = pair + 8L * (n * (n + 1) / 2);
            const int inner = m < n ? m : 0;
            for (int l = 0; l < inner; l++, t += 8) {
#pragma omp simd
               for (int v = 0; v < 8; v++) {
                  lm[8 * l + v] += t[v] * z[n];
                  ln[8 * l + v] += t[v] * z[m];
                  sum[v] += t[v] * z[l];
               }
            }
            for (int l = inner; l <= m; l++, t += 8) {
#pragma omp simd
               for (int v = 0; v < 8; v++) lm[8 * l + v] += t[v] * z[n];
               if (l == n) continue;
#pragma omp simd
               for (int v = 0; v < 8; v++) sum[v] += t[v] * z[l];
            }
            for (int v = 0; v < 8; v++) ln[8 * m + v] += sum[v];
         }
      }
      /* once contracted: a third of the derivatives; twice: y */
      double zero[8] = {0}, value[8] = {0};
      for (int i = 0; i < 8 * s; i++) dy[i] = 0.0;
      for (int m = 0, at = 0; m < count; m++) {
         double *dm = m > 0 ? dy + 8L * (m - 1) : zero;
         for (int l = 0; l <= m; l++, at++) {
            double *dl = l > 0 ? dy + 8L * (l - 1) : zero;
#pragma omp simd
            for (int v = 0; v < 8; v++) dm[v] += pair[8L * at + v] * z[l];
            if (l == m) continue;
#pragma omp simd
            for (int v = 0; v < 8; v++) dl[v] += pair[8L * at + v] * z[m];
         }
      }
      for (int v = 0; v < 8; v++) value[v] = zero[v];
      for (int k = 0; k < s; k++) {
#pragma omp simd
         for (int v = 0; v < 8; v++) {
            value[v] += dy[8L * k + v] * z[k + 1];
            dy[8L * k + v] *= 3.0;
         }
      }
      for (int v = 0; v < 8; v++) y[v] = value[v];
      for (int v = 0; restart && v < 8; v++) along[v] = value[v];
      for (int m = 0; m < s; m++) {
         const double *dm = dy + 8L * m;
         double sum = 0.0;
#pragma omp simd reduction(+ : sum)
         for (int v = 0; v < 8; v++) sum += dm[v] * y[v];
         force[m] += scale[piece] * sum;
         for (int k = 0; tangent && k <= m; k++) {
            const double *dk = dy + 8L * k;
            const double *km = pair + 8L * (k + 1 + (m + 1) * (m + 2) / 2);
            double both = 0.0;
#pragma omp simd reduction(+ : both)
            for (int v = 0; v < 8; v++) both += dk[v] * dm[v] + 6.0 * along[v] * km[v];
            stiffness[(long)m * s + k] += scale[piece] * both;
         }
      }
   }
}
