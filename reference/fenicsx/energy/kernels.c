/* Energy, gradient and Hessian of a law's integral over tets, WIDTH tets at a time: a `vec` has a number of each.

   law.h, which kernels.py writes, has the element (NODES, POINTS, the derivatives SHAPES of the shape functions on the
   reference tet, WEIGHTS that add up to 1; or PRISMS: six nodes and one point), the number PARAMETERS of the law's, and
   `law_stretches`: psi(s), its gradient and its Hessian, s the signed singular values of `decompose`. A law of HAS_PRESSURE has a pressure at each
   point, parameters[PARAMETERS]: the last four parameters are those of the corners, and CORNERS the corners' linear
   shape functions at the points. Tets come in rows of an array that is filled up to whole blocks of WIDTH by tets of
   volume 0. */

#include <math.h>
#include <stdint.h>
#include <string.h>

#if defined(__AVX512F__)
#define WIDTH 8
#elif defined(__AVX__)
#define WIDTH 4
#else
#define WIDTH 2
#endif

typedef double vec __attribute__((vector_size(8 * WIDTH)));
typedef int64_t mask __attribute__((vector_size(8 * WIDTH)));
typedef double loose __attribute__((vector_size(8 * WIDTH), aligned(8))); /* a vec in memory of Python's */

const int64_t width = WIDTH;

#define LANES(f) \
  static inline vec v##f(vec x) { \
    for (int l = 0; l < WIDTH; l++) x[l] = f(x[l]); \
    return x; \
  }
LANES(log) LANES(exp) LANES(sqrt) LANES(sin) LANES(cos) LANES(tanh) LANES(atan) LANES(fabs)

static inline vec vpow(vec x, double exponent) {
  for (int l = 0; l < WIDTH; l++) x[l] = pow(x[l], exponent);
  return x;
}

static inline vec select(mask m, vec a, vec b) { return (vec)((m & (mask)a) | (~m & (mask)b)); }
static inline vec larger(vec a, vec b) { return select(a > b, a, b); }
static inline vec smaller(vec a, vec b) { return select(a < b, a, b); }
static inline vec filled(double x) { return x + (vec){}; }

static inline int any(mask m) {
  int64_t found = 0;
  for (int l = 0; l < WIDTH; l++) found |= m[l];
  return found != 0;
}

static inline vec dot(const vec *a, const vec *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static inline void cross(const vec *a, const vec *b, vec *c) {
  c[0] = a[1] * b[2] - a[2] * b[1];
  c[1] = a[2] * b[0] - a[0] * b[2];
  c[2] = a[0] * b[1] - a[1] * b[0];
}

/* The larger entries t of a stationary point of `nearest` whose third is tau, and d ln(t[0] t[1])/d tau. */
static inline vec larger_entries(const vec *s, vec tau, vec *t) {
  const vec mu = tau * (tau - s[2]);
  vec slope = {};
  for (int i = 0; i < 2; i++) {
    const vec root = vsqrt(larger(s[i] * s[i] + 4.0 * mu, filled(0.0)));
    t[i] = 0.5 * (s[i] + root);
    slope += 1.0 / larger(t[i] * root, filled(1e-300));
  }
  return (2.0 * tau - s[2]) * slope;
}

/* Replace t by the flatter stationary point of `nearest` in the lanes `alike` where there is one and it is nearer.

   Its tau is the smallest. The product is concave from 0 to there, so Newton's method climbs to it and never past it;
   where it passes the top, there is none. */
static void flatten(const vec *s, vec target, mask alike, vec *t) {
  vec flat[3], tau = target / (s[0] * s[1]), far = {};
  for (int n = 0; n < 100; n++) {
    const vec slope = larger_entries(s, tau, flat), product = flat[0] * flat[1] * tau;
    const vec gain = product * (1.0 / tau + slope), after = tau + (target - product) / gain;
    alike &= (gain > 0.0) & (after < 0.5 * s[2]);
    const mask moved = alike & (vfabs(after - tau) > 4e-16 * tau);
    if (!any(moved)) break;
    tau = select(moved, after, tau);
  }
  larger_entries(s, tau, flat);
  flat[2] = tau;
  for (int i = 0; i < 3; i++) far += (flat[i] - s[i]) * (flat[i] - s[i]) - (t[i] - s[i]) * (t[i] - s[i]);
  for (int i = 0; i < 3; i++) t[i] = select(alike & (far < 0.0), flat[i], t[i]);
}

/* The positive t nearest to singular values s with t[0] t[1] t[2] = target > 0.

   Stationary points obey t_i (t_i - s_i) = mu, so t[2] = tau alone decides: mu = tau (tau - s[2]), and the others take
   the larger root. The product grows with tau on the bracket chosen here, where Newton is kept by bisection. Only
   stretches that differ by less than 6.1 %, of a product above six times the target, have a second such point. */
static void nearest(const vec *s, vec target, vec *t) {
  const mask below = (s[2] <= 0.0) | (s[0] * s[1] * s[2] <= target);
  vec third = target;
  for (int l = 0; l < WIDTH; l++) third[l] = cbrt(third[l]);
  vec low = select(below, larger(s[2], filled(0.0)), 0.5 * s[2]), high = select(below, third, s[2]);
  larger_entries(s, low, t);
  const mask far = ~below & (t[0] * t[1] * low > target); /* there the smallest stretch takes the smaller root */
  high = select(far, low, high);
  low = select(far, filled(0.0), low);
  vec tau = smaller(larger(s[2], low), high);
  tau = select(tau <= 0.0, high, tau);
  mask done = {};
  for (int n = 0; n < 200 && any(~done); n++) {
    const vec slope = larger_entries(s, tau, t), product = t[0] * t[1] * tau;
    const mask over = product > target;
    high = select(over, tau, high);
    low = select(over, low, tau);
    const vec gain = product * (1.0 / tau + slope), newton = tau - (product - target) / gain;
    const mask kept = (gain > 0.0) & (low <= newton) & (newton <= high);
    const vec after = select(kept, newton, 0.5 * (low + high));
    done |= vfabs(after - tau) <= 4e-16 * tau;
    tau = select(done, tau, after);
  }
  larger_entries(s, tau, t);
  t[2] = tau;
  const mask alike = (s[0] < 1.1 * s[2]) & (s[0] * s[1] * s[2] > 5.9 * target);
  if (any(alike)) flatten(s, target, alike, t);
}

/* stiffness/2 times the squared distance of F to {det = target}, by singular values.

   The nearest point's derivative is implicit: differentiating t - s = lambda grad c(t), c(t) = target, gives
   dt = Z (Z' M Z)^-1 Z' ds, Z a basis (a, b) of the surface's tangent plane and M = I - lambda hess c, whose entries
   off the diagonal are -mu/(t_i t_j). */
static inline vec volume_law(const vec *s, vec stiffness, vec target, vec *p, vec *h) {
  vec t[3], n[3], a[3], b[3], M[3];
  nearest(s, target, t);
  const vec mu = t[2] * (t[2] - s[2]);
  vec psi = {};
  for (int i = 0; i < 3; i++) {
    const int j = (i + 1) % 3, k = (i + 2) % 3;
    p[i] = stiffness * (s[i] - t[i]);
    psi += 0.5 * p[i] * (s[i] - t[i]);
    n[i] = t[j] * t[k];
    M[i] = -mu / n[i];
  }
  vec length = vsqrt(dot(n, n));
  for (int i = 0; i < 3; i++) n[i] /= length;
  for (int i = 0; i < 3; i++) a[i] = n[(i + 1) % 3] - n[(i + 2) % 3];
  const mask short_ = dot(a, a) < 0.25;
  a[0] = select(short_, -n[1], a[0]);
  a[1] = select(short_, n[0], a[1]);
  a[2] = select(short_, filled(0.0), a[2]);
  length = vsqrt(dot(a, a));
  for (int i = 0; i < 3; i++) a[i] /= length;
  cross(n, a, b);
  vec aa = filled(1.0), bb = filled(1.0), ab = {};
  for (int i = 0; i < 3; i++) {
    const int j = (i + 1) % 3, k = (i + 2) % 3;
    aa += 2.0 * M[i] * a[j] * a[k];
    bb += 2.0 * M[i] * b[j] * b[k];
    ab += M[i] * (a[j] * b[k] + b[j] * a[k]);
  }
  const vec det = larger(aa * bb - ab * ab, filled(1e-12)); /* zero where two nearest points merge */
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) {
      const vec moved = (bb * a[i] * a[j] - ab * (a[i] * b[j] + b[i] * a[j]) + aa * b[i] * b[j]) / det;
      h[3 * i + j] = stiffness * ((i == j) - moved);
    }
  return psi;
}

#include "law.h"

/* One-sided Jacobi: turns columns i and j of W orthogonal by a rotation that V collects; returns where it had to. */
static inline mask orthogonalise(vec W[3][3], vec V[3][3], int i, int j) {
  const vec a = dot(W[i], W[i]), b = dot(W[j], W[j]), g = dot(W[i], W[j]);
  const mask turned = vfabs(g) > 1e-15 * vsqrt(a * b);
  if (!any(turned)) return turned;
  const vec zeta = (b - a) / (2.0 * g), size = 1.0 / (vfabs(zeta) + vsqrt(1.0 + zeta * zeta));
  const vec t = select(turned, select(zeta >= 0.0, size, -size), filled(0.0)), c = 1.0 / vsqrt(1.0 + t * t);
  for (int k = 0; k < 3; k++) {
    const vec w = W[i][k], v = V[i][k];
    W[i][k] = c * (w - t * W[j][k]);
    W[j][k] = c * (t * w + W[j][k]);
    V[i][k] = c * (v - t * V[j][k]);
    V[j][k] = c * (t * v + V[j][k]);
  }
  return turned;
}

/* F = U diag(s) V' with rotations U and V, by columns, s[0] >= s[1] >= |s[2]|; s[2] has the sign of det F. */
static inline void decompose(const vec *F, vec U[3][3], vec *s, vec V[3][3]) {
  vec W[3][3], norms[3];
  for (int c = 0; c < 3; c++)
    for (int k = 0; k < 3; k++) {
      W[c][k] = F[3 * k + c];
      V[c][k] = filled(c == k);
    }
  for (int sweep = 0; sweep < 40; sweep++) {
    mask turned = orthogonalise(W, V, 0, 1);
    turned |= orthogonalise(W, V, 0, 2);
    turned |= orthogonalise(W, V, 1, 2);
    if (!any(turned)) break;
  }
  for (int c = 0; c < 3; c++) norms[c] = vsqrt(dot(W[c], W[c]));
  for (int n = 0; n < 3; n++) { /* sort; an exchange turns one column round, so that V stays a rotation */
    const int i = n % 2, j = i + 1;
    const mask exchange = norms[i] < norms[j];
    const vec norm = norms[i];
    norms[i] = select(exchange, norms[j], norm);
    norms[j] = select(exchange, norm, norms[j]);
    for (int k = 0; k < 3; k++) {
      const vec w = W[i][k], v = V[i][k];
      W[i][k] = select(exchange, W[j][k], w);
      W[j][k] = select(exchange, -w, W[j][k]);
      V[i][k] = select(exchange, V[j][k], v);
      V[j][k] = select(exchange, -v, V[j][k]);
    }
  }
  const vec tiny = 1e-300 + 1e-30 * norms[0];
  for (int k = 0; k < 3; k++) U[0][k] = select(norms[0] > tiny, W[0][k] / norms[0], filled(k == 0));
  const vec x = vfabs(U[0][0]), y = vfabs(U[0][1]), z = vfabs(U[0][2]);
  const mask first = (x <= y) & (x <= z), second = ~first & (y <= z); /* the axis farthest from U[0] */
  const mask axis[3] = {first, second, ~first & ~second};
  for (int k = 0; k < 3; k++)
    U[1][k] = select(norms[1] > tiny, W[1][k], select(axis[k], filled(1.0), filled(0.0)));
  const vec along = dot(U[0], U[1]);
  for (int k = 0; k < 3; k++) U[1][k] -= along * U[0][k];
  const vec length = vsqrt(dot(U[1], U[1]));
  for (int k = 0; k < 3; k++) U[1][k] /= length;
  cross(U[0], U[1], U[2]);
  s[0] = norms[0];
  s[1] = norms[1];
  s[2] = dot(W[2], U[2]);
}

/* Multiply every negative eigenvalue of a symmetric matrix by `kept`, by Jacobi's method. */
static inline void soften(vec A[3][3], double kept) {
  vec V[3][3], D[3][3];
  vec norm = {};
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) {
      D[i][j] = A[i][j];
      V[i][j] = filled(i == j);
      norm += D[i][j] * D[i][j];
    }
  for (int sweep = 0; sweep < 30; sweep++) {
    mask turned = {};
    for (int i = 0; i < 3; i++)
      for (int j = i + 1; j < 3; j++) {
        const vec g = D[i][j];
        const mask here = g * g > 1e-32 * norm;
        if (!any(here)) continue;
        turned |= here;
        const vec zeta = (D[j][j] - D[i][i]) / (2.0 * g), size = 1.0 / (vfabs(zeta) + vsqrt(1.0 + zeta * zeta));
        const vec t = select(here, select(zeta >= 0.0, size, -size), filled(0.0)), c = 1.0 / vsqrt(1.0 + t * t);
        for (int k = 0; k < 3; k++) {
          const vec d = D[i][k], v = V[i][k];
          D[i][k] = c * (d - t * D[j][k]);
          D[j][k] = c * (t * d + D[j][k]);
          V[i][k] = c * (v - t * V[j][k]);
          V[j][k] = c * (t * v + V[j][k]);
        }
        for (int k = 0; k < 3; k++) {
          const vec d = D[k][i];
          D[k][i] = c * (d - t * D[k][j]);
          D[k][j] = c * (t * d + D[k][j]);
        }
      }
    if (!any(turned)) break;
  }
  for (int k = 0; k < 3; k++) {
    const vec gain = (kept - 1.0) * smaller(D[k][k], filled(0.0));
    if (any(gain != 0.0))
      for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) A[i][j] += gain * V[k][i] * V[k][j];
  }
}

static inline vec law_stress(const vec *F, const vec *parameters, vec *P) {
  vec U[3][3], s[3], V[3][3], p[3], h[9];
  decompose(F, U, s, V);
  const vec psi = law_stretches(s, parameters, p, h);
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++)
      P[3 * i + j] = p[0] * U[0][i] * V[0][j] + p[1] * U[1][i] * V[1][j] + p[2] * U[2][i] * V[2][j];
  return psi;
}

#define SMALLEST_SUM 1e-9 /* below it the rotation nearest to F is not unique, and the twist's curvature not finite */
#define EQUAL 1e-5 /* relative distance of singular values below which the flip takes its limit; errors are 1e-10 */

/* dP/dF of an isotropic law, times w, added to pairs of nodes a < b: in the frames U and V of F it is the Hessian by
   singular values, and per pair (i, j) of them a twist (p_i + p_j)/(s_i + s_j) and a flip (p_i - p_j)/(s_i - s_j)
   (Smith, de Goes, Kim 2019, "Analytic Eigensystems for Isotropic Distortion Energies", Section 4). */
static inline void add_by_stretches(const vec *F, const vec *parameters, vec w, double kept, vec G[NODES][3],
                                    vec local[][9]) {
  vec U[3][3], s[3], V[3][3], p[3], h[3][3], same[3], crossed[3], turned[NODES][3];
  decompose(F, U, s, V);
  law_stretches(s, parameters, p, h[0]);
  for (int k = 0; k < 3; k++) { /* of the pair without k */
    const int i = k == 0, j = k == 2 ? 1 : 2;
    const vec total = s[i] + s[j], gap = s[i] - s[j];
    vec twist = (p[i] + p[j]) / select(vfabs(total) < SMALLEST_SUM, filled(SMALLEST_SUM), total);
    const mask equal = vfabs(gap) < EQUAL * larger(filled(1.0), vfabs(s[i]));
    const vec limit = 0.5 * (h[i][i] + h[j][j]) - h[i][j];
    vec flip = select(equal, limit, (p[i] - p[j]) / select(equal, filled(1.0), gap));
    twist = larger(twist, kept * twist);
    flip = larger(flip, kept * flip);
    same[k] = 0.5 * w * (flip + twist);
    crossed[k] = 0.5 * w * (flip - twist);
  }
  const vec minor = h[0][0] * h[1][1] - h[0][1] * h[0][1];
  const vec det = h[0][0] * (h[1][1] * h[2][2] - h[1][2] * h[1][2]) - h[0][1] * (h[0][1] * h[2][2] - h[0][2] * h[1][2])
                  + h[0][2] * (h[0][1] * h[1][2] - h[0][2] * h[1][1]);
  if (kept != 1.0 && any(~((h[0][0] > 0.0) & (minor > 0.0) & (det > 0.0)))) soften(h, kept);
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) h[i][j] *= w;
  for (int a = 0; a < NODES; a++)
    for (int j = 0; j < 3; j++) turned[a][j] = dot(G[a], V[j]);
  for (int a = 0; a < NODES; a++)
    for (int b = a + 1; b < NODES; b++, local++) {
      const vec *x = turned[a], *y = turned[b];
      vec K[3][3], KU[3][3];
      for (int i = 0; i < 3; i++) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        K[i][i] = h[i][i] * x[i] * y[i] + same[k] * x[j] * y[j] + same[j] * x[k] * y[k];
        K[i][j] = h[i][j] * x[i] * y[j] + crossed[k] * x[j] * y[i];
        K[j][i] = h[i][j] * x[j] * y[i] + crossed[k] * x[i] * y[j];
      }
      for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) KU[i][j] = K[i][0] * U[0][j] + K[i][1] * U[1][j] + K[i][2] * U[2][j];
      for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
          (*local)[3 * i + j] += U[0][i] * KU[0][j] + U[1][i] * KU[1][j] + U[2][i] * KU[2][j];
    }
}

#ifdef PRISMS
#define GEOMETRY (3 * NODES)
#else
#define GEOMETRY 9
#endif

/* What a block of tets is: nodes (tets, NODES), and by block geometry, volume and parameters. The geometry is the
   inverse of the Jacobian, and of prisms the gradients of their one F, by node. */
struct tets {
  int64_t blocks;
  const int64_t *nodes;
  const double *geometry, *volume, *parameters;
};

static inline void load(const struct tets *tets, int64_t block, const double *u, vec *geometry, vec *volume,
                        vec *parameters, vec at[NODES][3]) {
  const int64_t *nodes = tets->nodes + block * WIDTH * NODES;
  for (int k = 0; k < GEOMETRY; k++) geometry[k] = ((const loose *)tets->geometry)[GEOMETRY * block + k];
  *volume = ((const loose *)tets->volume)[block];
  for (int k = 0; k < PARAMETERS; k++) parameters[k] = ((const loose *)tets->parameters)[PARAMETERS * block + k];
  for (int a = 0; a < NODES; a++)
    for (int l = 0; l < WIDTH; l++)
      for (int i = 0; i < 3; i++) at[a][i][l] = u[3 * nodes[NODES * l + a] + i];
}

/* The shape functions' gradients G in space at a point, and F there, and the pressure if there is one. */
static inline void place(int point, const vec *geometry, const vec at[NODES][3], vec G[NODES][3], vec *F,
                         vec *parameters) {
#ifdef HAS_PRESSURE
  parameters[PARAMETERS] = filled(0.0);
  for (int k = 0; k < 4; k++) parameters[PARAMETERS] += CORNERS[point][k] * parameters[PARAMETERS - 4 + k];
#endif
  for (int i = 0; i < 9; i++) F[i] = filled(i % 4 == 0);
  for (int a = 0; a < NODES; a++) {
#ifdef PRISMS
    for (int j = 0; j < 3; j++) G[a][j] = geometry[3 * a + j];
#else
    const double *shape = SHAPES[point][a];
    for (int j = 0; j < 3; j++)
      G[a][j] = shape[0] * geometry[j] + shape[1] * geometry[3 + j] + shape[2] * geometry[6 + j];
#endif
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++) F[3 * i + j] += at[a][i] * G[a][j];
  }
}

/* The energy at a displacement u (nodes, 3); its gradient is added to an array like u. */
double energy(const struct tets *tets, const double *u, double *gradient) {
  vec total = {};
  for (int64_t block = 0; block < tets->blocks; block++) {
    const int64_t *nodes = tets->nodes + block * WIDTH * NODES;
    vec geometry[GEOMETRY], volume, parameters[PARAMETERS + 1], at[NODES][3], G[NODES][3], F[9], P[9], forces[NODES][3] = {};
    load(tets, block, u, geometry, &volume, parameters, at);
    for (int point = 0; point < POINTS; point++) {
      place(point, geometry, at, G, F, parameters);
      const vec w = WEIGHTS[point] * volume;
      total += w * law_stress(F, parameters, P);
      for (int i = 0; i < 9; i++) P[i] *= w;
      for (int a = 0; a < NODES; a++)
        for (int i = 0; i < 3; i++) forces[a][i] += dot(P + 3 * i, G[a]);
    }
    for (int l = 0; l < WIDTH; l++)
      for (int a = 0; a < NODES; a++)
        for (int i = 0; i < 3; i++) gradient[3 * nodes[NODES * l + a] + i] += forces[a][i][l];
  }
  double sum = 0.0;
  for (int l = 0; l < WIDTH; l++) sum += total[l];
  return sum;
}

/* P at the points of tets, shape (tets, POINTS, 9). */
void stress(const struct tets *tets, const double *u, double *into) {
  for (int64_t block = 0; block < tets->blocks; block++) {
    vec geometry[GEOMETRY], volume, parameters[PARAMETERS + 1], at[NODES][3], G[NODES][3], F[9], P[9];
    load(tets, block, u, geometry, &volume, parameters, at);
    for (int point = 0; point < POINTS; point++) {
      place(point, geometry, at, G, F, parameters);
      law_stress(F, parameters, P);
      for (int l = 0; l < WIDTH; l++)
        for (int i = 0; i < 9; i++) into[((block * WIDTH + l) * POINTS + point) * 9 + i] = P[i][l];
    }
  }
}

/* The energy's Hessian, every negative eigenvalue of every point's dP/dF multiplied by `kept`, added to `values`: a
   matrix in CSR of 3x3 blocks, whose row i has the blocks starts[i] to starts[i + 1]; `slots` (tets, NODES, NODES) say
   which block a pair of nodes has. Blocks of a node with itself follow from those of pairs, as translations are free. */
void hessian(const struct tets *tets, const double *u, double kept, const int64_t *starts, const int32_t *slots,
             double *values) {
  for (int64_t block = 0; block < tets->blocks; block++) {
    vec geometry[GEOMETRY], volume, parameters[PARAMETERS + 1], at[NODES][3], G[NODES][3], F[9];
    vec local[NODES * (NODES - 1) / 2][9] = {};
    load(tets, block, u, geometry, &volume, parameters, at);
    for (int point = 0; point < POINTS; point++) {
      place(point, geometry, at, G, F, parameters);
      const vec w = WEIGHTS[point] * volume;
      add_by_stretches(F, parameters, w, kept, G, local);
    }
    for (int l = 0; l < WIDTH; l++) {
      const int64_t tet = block * WIDTH + l, *nodes = tets->nodes + NODES * tet;
      const int32_t *slot = slots + NODES * NODES * tet;
      int64_t row[NODES], wide[NODES]; /* value (i, j) of block n of row a is values[row[a] + i wide[a] + 3 n + j] */
      for (int a = 0; a < NODES; a++) {
        row[a] = 6 * starts[nodes[a]];
        wide[a] = 3 * (starts[nodes[a] + 1] - starts[nodes[a]]);
      }
      for (int a = 0, pair = 0; a < NODES; a++)
        for (int b = a + 1; b < NODES; b++, pair++) {
          double *ab = values + row[a] + 3 * slot[NODES * a + b], *ba = values + row[b] + 3 * slot[NODES * b + a];
          double *aa = values + row[a] + 3 * slot[NODES * a + a], *bb = values + row[b] + 3 * slot[NODES * b + b];
          for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) {
              const double value = local[pair][3 * i + j][l];
              ab[i * wide[a] + j] += value;
              ba[j * wide[b] + i] += value;
              aa[i * wide[a] + j] -= value;
              bb[j * wide[b] + i] -= value;
            }
        }
    }
  }
}
