/* Thin shim over SuiteSparse: sparse Cholesky (CHOLMOD) and sparse QR (SPQR).
 *
 * * Matrices come in compressed form with 64-bit indices that start at 0; they are copied only
 * where the library requires it.
 *
 * * CHOLMOD's supernodal part and SPQR are under the GPL, and so is a binary that links them.
 */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <suitesparse/SuiteSparseQR_C.h>
#include <suitesparse/cholmod.h>
#include <suitesparse/umfpack.h>

enum { rk_done = 0, rk_singular = 1, rk_no_memory = 2 };

/* A factor with everything needed to solve with it */
struct factor {
    cholmod_common common;
    int64_t n;
    cholmod_factor *cholesky; /* or */
    cholmod_sparse *r;        /* upper triangular, with */
    SuiteSparse_long *order;  /* column order, NULL if none */
    cholmod_dense *x, *y, *e; /* work of a solve */
    void *symbolic;           /* or UMFPACK's order of elimination */
};

void rk_sparse_free(struct factor *f)
{
    if (!f)
        return;
    umfpack_dl_free_symbolic(&f->symbolic);
    cholmod_l_free_factor(&f->cholesky, &f->common);
    cholmod_l_free_sparse(&f->r, &f->common);
    if (f->order)
        cholmod_l_free(f->n, sizeof(SuiteSparse_long), f->order, &f->common);
    cholmod_l_free_dense(&f->x, &f->common);
    cholmod_l_free_dense(&f->y, &f->common);
    cholmod_l_free_dense(&f->e, &f->common);
    cholmod_l_finish(&f->common);
    free(f);
}

static struct factor *new_factor(int64_t n)
{
    struct factor *f = calloc(1, sizeof *f);
    if (!f)
        return NULL;
    f->n = n;
    cholmod_l_start(&f->common);
    f->common.print = 0;
    f->common.final_ll = 1; /* L D L' passes over negative D */
    return f;
}

static cholmod_sparse matrix(int64_t rows, int64_t columns, int64_t *start, int64_t *row,
                             double *value, int stype)
{
    cholmod_sparse a;
    memset(&a, 0, sizeof a);
    a.nrow = (size_t)rows;
    a.ncol = (size_t)columns;
    a.nzmax = (size_t)start[columns];
    a.p = start;
    a.i = row;
    a.x = value;
    a.stype = stype;
    a.itype = CHOLMOD_LONG;
    a.xtype = CHOLMOD_REAL;
    a.dtype = CHOLMOD_DOUBLE;
    a.sorted = 1;
    a.packed = 1;
    return a;
}

static cholmod_dense vectors(int64_t n, int64_t number, double *value)
{
    cholmod_dense v;
    memset(&v, 0, sizeof v);
    v.nrow = v.d = (size_t)n;
    v.ncol = (size_t)number;
    v.nzmax = v.nrow * v.ncol;
    v.x = value;
    v.xtype = CHOLMOD_REAL;
    v.dtype = CHOLMOD_DOUBLE;
    return v;
}

static int state(const cholmod_common *c)
{
    if (c->status == CHOLMOD_OUT_OF_MEMORY || c->status == CHOLMOD_TOO_LARGE)
        return rk_no_memory;
    return c->status == CHOLMOD_OK ? rk_done : rk_singular;
}

/* Solve R x = y; y is overwritten */
static void solve_upper(const struct factor *f, double *y, double *x)
{
    const SuiteSparse_long *p = f->r->p, *i = f->r->i;
    const double *r = f->r->x;
    for (int64_t j = f->n - 1; j >= 0; j--) {
        y[j] /= r[p[j + 1] - 1];
        for (int64_t k = p[j]; k < p[j + 1] - 1; k++)
            y[i[k]] -= r[k] * y[j];
    }
    for (int64_t j = 0; j < f->n; j++)
        x[f->order ? f->order[j] : j] = y[j];
}

/* Least squares solution by QR factorisation of an m x n matrix in compressed rows, whose R is
 * kept; columns below the tolerance count as dependent */
int rk_sparse_qr(int64_t m, int64_t n, int64_t *start, int64_t *column, double *value, double *b,
                 double tol, double *x, struct factor **out)
{
    struct factor *f = *out = new_factor(n);
    if (!f)
        return rk_no_memory;
    cholmod_sparse at = matrix(n, m, start, column, value, 0);
    cholmod_sparse *a = cholmod_l_transpose(&at, 1, &f->common);
    if (!a)
        return rk_no_memory;
    cholmod_dense right = vectors(m, 1, b);
    const int64_t rank =
        SuiteSparseQR_C(SPQR_ORDERING_DEFAULT, tol, n, 0, a, NULL, &right, NULL, &f->x, &f->r,
                        &f->order, NULL, NULL, NULL, &f->common);
    cholmod_l_free_sparse(&a, &f->common);
    int stat = state(&f->common);
    if (stat == rk_done && rank < n)
        stat = rk_singular;
    if (stat == rk_done) {
        cholmod_l_sort(f->r, &f->common);
        solve_upper(f, f->x->x, x);
    }
    return stat;
}

/* Solve in place with a Cholesky factor, for vectors of this total length, or with R^T R for one
 * vector; the result is NaN if memory runs out */
void rk_sparse_solve(struct factor *f, int64_t length, double *x)
{
    if (f->cholesky) {
        cholmod_dense b = vectors(f->n, length / f->n, x);
        const int solved = cholmod_l_solve2(CHOLMOD_A, f->cholesky, &b, NULL, &f->x, NULL, &f->y,
                                            &f->e, &f->common);
        for (size_t k = 0; k < b.nzmax; k++)
            x[k] = solved ? ((double *)f->x->x)[k] : NAN;
        return;
    }
    const SuiteSparse_long *p = f->r->p, *i = f->r->i;
    const double *r = f->r->x;
    double *y = f->x->x;
    for (int64_t j = 0; j < f->n; j++) {
        double sum = x[f->order ? f->order[j] : j];
        for (int64_t k = p[j]; k < p[j + 1] - 1; k++)
            sum -= r[k] * y[i[k]];
        y[j] = sum / r[p[j + 1] - 1];
    }
    solve_upper(f, y, x);
}

/* Solve with a square matrix in compressed columns: Cholesky of an upper triangle, or LU of the
 * whole matrix. The elimination order and the memory of a Cholesky factor are kept for further
 * matrices of the same pattern. Without b and x a matrix is only factorised. */
int rk_sparse_direct(int64_t n, int64_t *start, int64_t *row, double *value, int definite,
                     const double *b, double *x, double *rcond, struct factor **kept)
{
    *rcond = 0;
    if (!*kept)
        *kept = new_factor(n);
    struct factor *f = *kept;
    if (!f)
        return rk_no_memory;
    if (definite) {
        cholmod_sparse a = matrix(n, n, start, row, value, 1);
        if (!f->cholesky)
            f->cholesky = cholmod_l_analyze(&a, &f->common);
        if (f->cholesky)
            cholmod_l_factorize(&a, f->cholesky, &f->common);
        int stat = state(&f->common);
        if (stat == rk_done && b) {
            *rcond = cholmod_l_rcond(f->cholesky, &f->common);
            memcpy(x, b, (size_t)n * sizeof *x);
            rk_sparse_solve(f, n, x);
            stat = state(&f->common);
        } else if (stat != rk_done && f->cholesky) {
            /* an unfinished factor only takes memory that LU needs */
            cholmod_l_change_factor(CHOLMOD_PATTERN, f->cholesky->is_ll, f->cholesky->is_super, 1,
                                    1, f->cholesky, &f->common);
        }
        return stat;
    }
    double info[UMFPACK_INFO], control[UMFPACK_CONTROL];
    umfpack_dl_defaults(control);
    /* the pattern is symmetric even where zeros hide it; an ordering of columns would fill in */
    control[UMFPACK_STRATEGY] = UMFPACK_STRATEGY_SYMMETRIC;
    /* minimum degree, and nested dissection where that gives much fill-in */
    control[UMFPACK_ORDERING] = UMFPACK_ORDERING_CHOLMOD;
    void *numeric = NULL;
    long stat = UMFPACK_OK;
    if (!f->symbolic)
        stat = umfpack_dl_symbolic(n, n, start, row, value, &f->symbolic, control, info);
    if (stat == UMFPACK_OK)
        stat = umfpack_dl_numeric(start, row, value, f->symbolic, &numeric, control, info);
    if (stat == UMFPACK_OK) {
        *rcond = info[UMFPACK_RCOND];
        stat = umfpack_dl_solve(UMFPACK_A, start, row, value, x, b, numeric, control, info);
    }
    umfpack_dl_free_numeric(&numeric);
    if (stat == UMFPACK_ERROR_out_of_memory)
        return rk_no_memory;
    return stat == UMFPACK_OK ? rk_done : rk_singular;
}
