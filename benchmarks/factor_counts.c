/* Operations and entries of the Cholesky factor that rk_sparse_direct would make, in CHOLMOD's own
 * order or, where one is given, in the better of both. */
#include <stdint.h>
#include <string.h>
#include <suitesparse/cholmod.h>

void factor_counts(int64_t n, int64_t *start, int64_t *row, double *value, int64_t *order,
                   double *operations, double *entries)
{
    cholmod_common common;
    cholmod_sparse a;
    cholmod_l_start(&common);
    memset(&a, 0, sizeof a);
    a.nrow = a.ncol = (size_t)n;
    a.nzmax = (size_t)start[n];
    a.p = start;
    a.i = row;
    a.x = value;
    a.stype = a.sorted = a.packed = 1;
    a.itype = CHOLMOD_LONG;
    a.xtype = CHOLMOD_REAL;
    cholmod_factor *factor = cholmod_l_analyze_p(&a, order, NULL, 0, &common);
    *operations = common.fl;
    *entries = common.lnz;
    cholmod_l_free_factor(&factor, &common);
    cholmod_l_finish(&common);
}
