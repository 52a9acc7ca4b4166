/* The observation update of the three filters with known association, in plain C: what speed is measured against, and an
 * independent implementation to compare numbers with.
 *
 * K particles, Z observations (range, bearing) of known points, N points in each map.  Everything is double, row by row,
 * and updated in place:
 *
 *   s (K, 3)  P (K, 3, 3)  log_w (K)  map (K, N, 5): x, y, Sigma_xx, Sigma_xy, Sigma_yy       the particles
 *   n (K, Z) int64         z (Z, 2)   R (Z, 3): rr, rb, bb                                    what was seen, and of what
 *   normal (K, 3)                                                                             standard normal draws
 *
 * Symmetric 2x2 matrices are (xx, xy, yy) throughout.  Strict floating point, one particle at a time.
 */

#include <math.h>
#include <stdint.h>
#include <string.h>

#define PI 3.14159265358979323846
#define LOG_TWO_PI 1.8378770664093454836

typedef struct { double xx, xy, yy; } Sym2;
typedef struct { double x, y; Sym2 Sigma; } Feature;

typedef struct {
    double v[2], Gs[2][3], Gt[2][2];
} Innovation;

static inline double wrap(double a)
{
    if (a >= -PI && a < PI) return a;
    return a - 2 * PI * floor((a + PI) / (2 * PI));
}

/* (23, 24, 45) */
static inline Innovation innovation(const double s[3], const Feature *f, const double z[2])
{
    double dx = f->x - s[0], dy = f->y - s[1];
    double d = sqrt(dx * dx + dy * dy), per_d = 1 / d;
    double c = dx * per_d, q = dy * per_d;
    Innovation o = {
        {z[0] - d, wrap(z[1] - atan2(dy, dx) + s[2])},
        {{-c, -q, 0}, {q * per_d, -c * per_d, -1}},
        {{c, q}, {-q * per_d, c * per_d}},
    };
    return o;
}

static inline Sym2 add(Sym2 A, Sym2 B)
{
    return (Sym2){A.xx + B.xx, A.xy + B.xy, A.yy + B.yy};
}

/* A S A^T */
static inline Sym2 sandwich(const double A[2][2], Sym2 S)
{
    double x0 = A[0][0] * S.xx + A[0][1] * S.xy, y0 = A[0][0] * S.xy + A[0][1] * S.yy;
    double x1 = A[1][0] * S.xx + A[1][1] * S.xy, y1 = A[1][0] * S.xy + A[1][1] * S.yy;
    return (Sym2){x0 * A[0][0] + y0 * A[0][1], x0 * A[1][0] + y0 * A[1][1], x1 * A[1][0] + y1 * A[1][1]};
}

static inline Sym2 inverse(Sym2 V)
{
    double scale = 1 / (V.xx * V.yy - V.xy * V.xy);
    return (Sym2){V.yy * scale, -V.xy * scale, V.xx * scale};
}

/* log N(v; 0, V) (43) */
static inline double log_density(const double v[2], Sym2 V, Sym2 Vi)
{
    double d2 = Vi.xx * v[0] * v[0] + 2 * Vi.xy * v[0] * v[1] + Vi.yy * v[1] * v[1];
    return -LOG_TWO_PI - 0.5 * log(V.xx * V.yy - V.xy * V.xy) - 0.5 * d2;
}

/* Rows of G_s P, which give V = G_s P G_s^T + noise and the gain */
static inline Sym2 pose_term(const double Gs[2][3], const double P[3][3], double GP[2][3])
{
    for (int a = 0; a < 2; a++)
        for (int j = 0; j < 3; j++) GP[a][j] = Gs[a][0] * P[0][j] + Gs[a][1] * P[1][j] + Gs[a][2] * P[2][j];
    return (Sym2){
        GP[0][0] * Gs[0][0] + GP[0][1] * Gs[0][1] + GP[0][2] * Gs[0][2],
        GP[0][0] * Gs[1][0] + GP[0][1] * Gs[1][1] + GP[0][2] * Gs[1][2],
        GP[1][0] * Gs[1][0] + GP[1][1] * Gs[1][1] + GP[1][2] * Gs[1][2],
    };
}

/* EKF update of the pose (28), Joseph form */
static inline void update_pose(double s[3], double P[3][3], const Innovation *o, const double GP[2][3], Sym2 noise,
                               Sym2 Vi)
{
    double K[3][2], KR[3][2], A[3][3], AP[3][3];
    for (int i = 0; i < 3; i++) {
        K[i][0] = GP[0][i] * Vi.xx + GP[1][i] * Vi.xy;
        K[i][1] = GP[0][i] * Vi.xy + GP[1][i] * Vi.yy;
        KR[i][0] = K[i][0] * noise.xx + K[i][1] * noise.xy;
        KR[i][1] = K[i][0] * noise.xy + K[i][1] * noise.yy;
        s[i] += K[i][0] * o->v[0] + K[i][1] * o->v[1];
        for (int j = 0; j < 3; j++) A[i][j] = (i == j) - K[i][0] * o->Gs[0][j] - K[i][1] * o->Gs[1][j];
    }
    s[2] = wrap(s[2]);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) AP[i][j] = A[i][0] * P[0][j] + A[i][1] * P[1][j] + A[i][2] * P[2][j];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j <= i; j++)
            P[i][j] = P[j][i] = AP[i][0] * A[j][0] + AP[i][1] * A[j][1] + AP[i][2] * A[j][2]
                              + KR[i][0] * K[j][0] + KR[i][1] * K[j][1];
}

/* The same for a feature */
static inline void update_feature(Feature *f, const Innovation *o, Sym2 R, Sym2 Vi)
{
    Sym2 S = f->Sigma;
    const double (*G)[2] = o->Gt;
    double SG[2][2] = {
        {S.xx * G[0][0] + S.xy * G[0][1], S.xx * G[1][0] + S.xy * G[1][1]},
        {S.xy * G[0][0] + S.yy * G[0][1], S.xy * G[1][0] + S.yy * G[1][1]},
    };
    double K[2][2], A[2][2];
    for (int i = 0; i < 2; i++) {
        K[i][0] = SG[i][0] * Vi.xx + SG[i][1] * Vi.xy;
        K[i][1] = SG[i][0] * Vi.xy + SG[i][1] * Vi.yy;
        for (int j = 0; j < 2; j++) A[i][j] = (i == j) - K[i][0] * G[0][j] - K[i][1] * G[1][j];
    }
    f->x += K[0][0] * o->v[0] + K[0][1] * o->v[1];
    f->y += K[1][0] * o->v[0] + K[1][1] * o->v[1];
    f->Sigma = add(sandwich(A, S), sandwich(K, R));
}

/* s ~ N(s, P) through a lower factor of a P that may be singular (12) */
static inline void draw_pose(double s[3], const double P[3][3], const double normal[3])
{
    double L[3][3] = {{0}};
    for (int j = 0; j < 3; j++) {
        double pivot = P[j][j];
        for (int l = 0; l < j; l++) pivot -= L[j][l] * L[j][l];
        if (pivot <= 1e-15 * P[j][j]) continue;
        L[j][j] = sqrt(pivot);
        for (int i = j + 1; i < 3; i++) {
            double entry = P[i][j];
            for (int l = 0; l < j; l++) entry -= L[i][l] * L[j][l];
            L[i][j] = entry / L[j][j];
        }
    }
    for (int i = 0; i < 3; i++)
        for (int j = 0; j <= i; j++) s[i] += L[i][j] * normal[j];
    s[2] = wrap(s[2]);
}

void fastslam1(int64_t K, int64_t N, int64_t Z, const int64_t *n, const double (*z)[2], const Sym2 *R,
               const double (*s)[3], Feature *map, double *log_w)
{
    for (int64_t k = 0; k < K; k++)
        for (int64_t i = 0; i < Z; i++) {
            Feature *f = &map[k * N + n[k * Z + i]];
            Innovation o = innovation(s[k], f, z[i]);
            Sym2 V = add(sandwich(o.Gt, f->Sigma), R[i]), Vi = inverse(V);
            log_w[k] += log_density(o.v, V, Vi);
            update_feature(f, &o, R[i], Vi);
        }
}

void fastslam2(int64_t K, int64_t N, int64_t Z, const int64_t *n, const double (*z)[2], const Sym2 *R,
               const double (*normal)[3], double (*s)[3], double (*P)[3][3], Feature *map, double *log_w)
{
    for (int64_t k = 0; k < K; k++) {
        double GP[2][3];
        for (int64_t i = 0; i < Z; i++) { /* the proposal and its weight (14) */
            Feature *f = &map[k * N + n[k * Z + i]];
            Innovation o = innovation(s[k], f, z[i]);
            Sym2 noise = add(sandwich(o.Gt, f->Sigma), R[i]);
            Sym2 V = add(pose_term(o.Gs, P[k], GP), noise), Vi = inverse(V);
            log_w[k] += log_density(o.v, V, Vi);
            update_pose(s[k], P[k], &o, GP, noise, Vi);
        }
        draw_pose(s[k], P[k], normal[k]);
        memset(P[k], 0, sizeof P[k]);
        for (int64_t i = 0; i < Z; i++) {
            Feature *f = &map[k * N + n[k * Z + i]];
            Innovation o = innovation(s[k], f, z[i]);
            update_feature(f, &o, R[i], inverse(add(sandwich(o.Gt, f->Sigma), R[i])));
        }
    }
}

void dual_fastslam(int64_t K, int64_t N, int64_t Z, const int64_t *n, const double (*z)[2], const Sym2 *R,
                   double (*s)[3], double (*P)[3][3], const Feature *map, double *log_w)
{
    for (int64_t k = 0; k < K; k++) {
        double GP[2][3];
        for (int64_t i = 0; i < Z; i++) { /* the marginal weight (43), at the predicted pose */
            Innovation o = innovation(s[k], &map[k * N + n[k * Z + i]], z[i]);
            Sym2 V = add(pose_term(o.Gs, P[k], GP), R[i]);
            log_w[k] += log_density(o.v, V, inverse(V));
        }
        for (int64_t i = 0; i < Z; i++) {
            Innovation o = innovation(s[k], &map[k * N + n[k * Z + i]], z[i]);
            Sym2 Vi = inverse(add(pose_term(o.Gs, P[k], GP), R[i]));
            update_pose(s[k], P[k], &o, GP, R[i], Vi);
        }
    }
}
