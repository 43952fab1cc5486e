/* One block of the model integrated over many responses, with exact derivatives: what `kernel.py` does in numpy, compiled.

   LANES responses at a time. The equations come as programs (`native.py`): lists of instructions on slots of LANES numbers, in three parts
   that depend on parameters alone, on measured signals, on states. RK4 and its forward sensitivities touch only the entries of the
   Jacobian, and only the columns of each state, that can differ from zero. */

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#ifdef VECTOR_FUNCTIONS /* of the C library (libmvec of glibc): several arguments at once, to 4 units in the last place */
#define OF_VECTORS __attribute__((simd("notinbranch")))
extern double sin(double) OF_VECTORS;
extern double cos(double) OF_VECTORS;
extern double exp(double) OF_VECTORS;
extern double log(double) OF_VECTORS;
extern double pow(double, double) OF_VECTORS;
#endif

#define LANES 16
#define WIDTH 5 /* numbers of an instruction */
#define SHORTEST_S 1e-7 /* as `filters.Butterworth.SHORTEST_S` */

typedef double lanes __attribute__((vector_size(LANES * sizeof(double))));

/* Instructions (operation, result, first, second, third); a constant's first is its index. Inputs are the first slots: x, p, u, e, d. */
typedef struct {
    int64_t count, by_parameters, by_signals, slots;
    const int32_t *code;
    const double *constants;
    const int32_t *results;
} program;

/* Entries of a Jacobian that can differ from zero: row, column (states first, then the columns). */
typedef struct {
    int64_t count;
    const int32_t *rows, *columns;
} entries;

typedef struct {
    int64_t n_x, n_p, n_u, n_e, n_d, n_y, n_c, n_started, n_free;
    program rate, output, rate_alone, output_alone; /* the latter without the entries of their Jacobians */
    entries by_rate, by_output;
    const int32_t *active_first, *active; /* columns that each state can depend on */
    const int32_t *seen_first, *seen;     /* the same of each output */
    const int32_t *started;               /* states with a free initial value */
    const double *initial;                /* of every state */
    const double *filter;                 /* angular frequency of each output's filter, 0 where there is none */
} block;

typedef struct {
    int64_t m, n_data, n, slopes;
    const double *p, *local, *nodes, *delay_slope;
    const uint8_t *mask;
    const int64_t *first, *target, *order;
    double *y, *dy;
} task;

typedef struct {
    const program *of;
    lanes *w, *known; /* slots; the signals that the second part was last run for */
    int fresh;
} machine;

#define EACH for (int l = 0; l < LANES; l++)
#define WITH(name, act) name: act; NEXT;
/* Through arrays, whose loops compilers turn into vector instructions. */
#define APPLY2(name, e) name: { \
        double first[LANES], second[LANES], made[LANES]; \
        memcpy(first, &w[at[2]], sizeof(first)); \
        memcpy(second, &w[at[3]], sizeof(second)); \
        EACH { const double x = first[l], y = second[l]; (void)y; made[l] = (e); } \
        memcpy(&w[at[1]], made, sizeof(made)); \
    } NEXT;
#define APPLY(name, f) APPLY2(name, f(x))
#define TRUTH(name, e) APPLY2(name, (e) ? 1.0 : 0.0)
/* Each operation jumps to the next by itself, which processors foresee better than one jump for all. */
#define NEXT do { at += WIDTH; if (at == end) return; goto *jump[at[0]]; } while (0)

static void execute(const program *of, lanes *w, int64_t from, int64_t to) {
    static const void *const jump[] = {
        &&CONST_, &&ADD, &&SUB, &&MUL, &&DIV, &&NEG, &&SQ, &&TWICE, &&INV, &&SQRT, &&SIN, &&COS, &&TAN, &&ASIN, &&ACOS, &&ATAN, &&SINH,
        &&COSH, &&TANH, &&ASINH, &&ACOSH, &&ATANH, &&EXP, &&EXPM1, &&LOG, &&LOG1P, &&FABS, &&SIGN, &&FLOOR, &&CEIL, &&ASSIGN, &&POW,
        &&FMIN, &&FMAX, &&FMOD, &&COPYSIGN, &&HYPOT, &&ATAN2, &&LT, &&LE, &&EQ, &&NE, &&AND, &&OR, &&NOT, &&IF_ELSE_ZERO, &&MUL_ADD,
        &&MUL_SUB, &&SUB_MUL}; /* in the order of `native._NAMES` */
    const int32_t *at = of->code + WIDTH * from, *end = of->code + WIDTH * to;
    if (at == end) return;
    goto *jump[at[0]];
    WITH(CONST_, EACH w[at[1]][l] = of->constants[at[2]])
    WITH(ADD, w[at[1]] = w[at[2]] + w[at[3]])
    WITH(SUB, w[at[1]] = w[at[2]] - w[at[3]])
    WITH(MUL, w[at[1]] = w[at[2]] * w[at[3]])
    WITH(DIV, w[at[1]] = w[at[2]] / w[at[3]])
    WITH(MUL_ADD, w[at[1]] = w[at[2]] * w[at[3]] + w[at[4]])
    WITH(MUL_SUB, w[at[1]] = w[at[2]] * w[at[3]] - w[at[4]])
    WITH(SUB_MUL, w[at[1]] = w[at[4]] - w[at[2]] * w[at[3]])
    WITH(NEG, w[at[1]] = -w[at[2]])
    WITH(SQ, w[at[1]] = w[at[2]] * w[at[2]])
    WITH(TWICE, w[at[1]] = w[at[2]] + w[at[2]])
    WITH(INV, w[at[1]] = 1.0 / w[at[2]])
    WITH(ASSIGN, w[at[1]] = w[at[2]])
    APPLY(SQRT, sqrt)
    APPLY(SIN, sin)
    APPLY(COS, cos)
    APPLY2(TAN, sin(x) / cos(x))
    APPLY(ASIN, asin)
    APPLY(ACOS, acos)
    APPLY(ATAN, atan)
    APPLY(SINH, sinh)
    APPLY(COSH, cosh)
    APPLY(TANH, tanh)
    APPLY(ASINH, asinh)
    APPLY(ACOSH, acosh)
    APPLY(ATANH, atanh)
    APPLY(EXP, exp)
    APPLY(EXPM1, expm1)
    APPLY(LOG, log)
    APPLY(LOG1P, log1p)
    APPLY(FABS, fabs)
    APPLY(FLOOR, floor)
    APPLY(CEIL, ceil)
    APPLY2(POW, pow(x, y))
    APPLY2(FMIN, x < y ? x : y)
    APPLY2(FMAX, x > y ? x : y)
    APPLY2(FMOD, fmod(x, y))
    APPLY2(COPYSIGN, copysign(x, y))
    APPLY2(HYPOT, hypot(x, y))
    APPLY2(ATAN2, atan2(x, y))
    TRUTH(LT, x < y)
    TRUTH(LE, x <= y)
    TRUTH(EQ, x == y)
    TRUTH(NE, x != y)
    TRUTH(AND, x != 0.0 && y != 0.0)
    TRUTH(OR, x != 0.0 || y != 0.0)
    TRUTH(NOT, x == 0.0)
    APPLY2(SIGN, x > 0 ? 1.0 : x < 0 ? -1.0 : x)
    APPLY2(IF_ELSE_ZERO, x != 0.0 ? y : 0.0)
}

/* Run a program for states x and signals (u, then e); results lie in its slots. */
static void evaluate(machine *now, const block *of, const lanes *x, const lanes *signals) {
    const int64_t n = of->n_u + of->n_e;
    const size_t size = n * sizeof(lanes);
    memcpy(now->w, x, of->n_x * sizeof(lanes));
    if (!now->fresh || memcmp(now->known, signals, size)) {
        memcpy(now->known, signals, size);
        memcpy(now->w + of->n_x + of->n_p, signals, size);
        execute(now->of, now->w, now->of->by_parameters, now->of->by_signals);
        now->fresh = 1;
    }
    execute(now->of, now->w, now->of->by_signals, now->of->count);
}

#define RESULT(machine, i) ((machine).w[(machine).of->results[i]])

/* Derivatives of outputs (n_y, n_c) from those of the states (n_x, n_c); of filtered outputs only where asked. */
static void observe(const block *of, const machine *now, const lanes *slope, lanes *found, int filtered_only) {
    const int64_t n_c = of->n_c;
    memset(found, 0, of->n_y * n_c * sizeof(lanes));
    for (int64_t i = 0; i < of->by_output.count; i++) {
        const int32_t r = of->by_output.rows[i], s = of->by_output.columns[i];
        if (filtered_only && of->filter[r] == 0.0) continue;
        const lanes j = RESULT(*now, of->n_y + i);
        if (s >= of->n_x) {
            found[r * n_c + s - of->n_x] += j;
            continue;
        }
        for (int32_t k = of->active_first[s]; k < of->active_first[s + 1]; k++) {
            const int32_t c = of->active[k];
            found[r * n_c + c] += j * slope[s * n_c + c];
        }
    }
}

/* exp(A h) of a filter and what the parabola through y0, ym, y1 adds to (output, rate), as in `filters.py`. */
typedef struct {
    lanes e11, e12, e21, e22, h;
    double w, lag;
} pace;

static pace paced(double w, const lanes *h) {
    pace at = {.w = w, .lag = sqrt(2.0) / w};
    const double a = w / sqrt(2.0);
    EACH {
        const double t = (*h)[l] > SHORTEST_S ? (*h)[l] : SHORTEST_S;
        const double decay = exp(-a * t), c = cos(a * t), s = sin(a * t);
        at.h[l] = t;
        at.e11[l] = decay * (c + s);
        at.e12[l] = decay * s / a;
        at.e21[l] = -2 * a * decay * s;
        at.e22[l] = decay * (c - s);
    }
    return at;
}

static void forced(const pace *at, const lanes *y0, const lanes *ym, const lanes *y1, lanes *z, lanes *rate) {
    const lanes h = at->h, bend = *ym - 0.5 * (*y0 + *y1), u2 = -4.0 * bend / (h * h), u1 = (*y1 - *y0) / h + 4.0 * bend / h;
    const lanes b = u1 - 2.0 * at->lag * u2, a = *y0 - 2.0 * u2 / (at->w * at->w) - at->lag * b;
    *z = a + b * h + u2 * h * h - at->e11 * a - at->e12 * b;
    *rate = b + 2.0 * u2 * h - at->e21 * a - at->e22 * b;
}

static void start(machine *now, const block *of, const task *todo, const int64_t *who, const lanes *d) {
    for (int64_t i = 0; i < of->n_p; i++) EACH now->w[of->n_x + i][l] = todo->p[who[l] * of->n_p + i];
    memcpy(now->w + of->n_x + of->n_p + of->n_u + of->n_e, d, of->n_d * sizeof(lanes));
    execute(now->of, now->w, 0, now->of->by_parameters);
    now->fresh = 0;
}

/* What the derivatives of the states by the delay jump by where inputs change: a later edge keeps the rate of before for longer. */
static void pass_edge(
    machine *alone, const block *of, const task *todo, const lanes *x, const lanes *before, const lanes *after, lanes *jump, lanes *slope
) {
    evaluate(alone, of, x, before);
    for (int64_t i = 0; i < of->n_x; i++) jump[i] = RESULT(*alone, i);
    evaluate(alone, of, x, after);
    for (int64_t i = 0; i < of->n_x; i++) {
        jump[i] -= RESULT(*alone, i);
        for (int64_t c = 0; c < of->n_c; c++)
            if (todo->delay_slope[c] != 0.0) slope[i * of->n_c + c] += todo->delay_slope[c] * jump[i];
    }
}

static lanes *taken(lanes **from, int64_t count) {
    lanes *at = *from;
    *from += count;
    return at;
}

/* Simulate todo->m responses; 0 where memory was found. */
int integrate(const block *of, const task *todo) {
    const int64_t n_x = of->n_x, n_c = todo->slopes ? of->n_c : 0, n_y = of->n_y, n_s = of->n_u + of->n_e, wide = n_x * n_c;
    const int64_t n_local = of->n_started + of->n_d, seen = n_y * n_c;
    int filters = 0, moved = 0;
    for (int64_t o = 0; o < n_y; o++) filters += of->filter[o] != 0.0;
    const program *f = n_c ? &of->rate : &of->rate_alone, *g = n_c ? &of->output : &of->output_alone;
    const int64_t room = f->slots + g->slots + of->rate_alone.slots + 8 * n_s + 9 * n_x + of->n_d + 6 * wide + 5 * n_y + 5 * seen + 64;
    lanes *memory = aligned_alloc(sizeof(lanes), room * sizeof(lanes));
    if (!memory) return 1;
    memset(memory, 0, room * sizeof(lanes));
    for (int64_t c = 0; c < n_c; c++) moved |= todo->delay_slope[c] != 0.0;
    lanes *from = memory;
    machine rate = {f, taken(&from, f->slots), taken(&from, n_s), 0}, output = {g, taken(&from, g->slots), taken(&from, n_s), 0};
    machine alone = {&of->rate_alone, taken(&from, of->rate_alone.slots), taken(&from, n_s), 0};
    lanes *before = taken(&from, n_s), *jump = taken(&from, n_x);
    lanes *at_start = taken(&from, n_s), *at_middle = taken(&from, n_s), *at_end = taken(&from, n_s), *d = taken(&from, of->n_d);
    lanes *x = taken(&from, n_x), *ahead = taken(&from, n_x), *k = taken(&from, n_x), *total = taken(&from, n_x);
    lanes *first_k = taken(&from, n_x), *after = taken(&from, n_x), *middle = taken(&from, n_x);
    lanes *slope = taken(&from, wide), *d_ahead = taken(&from, wide), *d_k = taken(&from, wide), *d_total = taken(&from, wide);
    lanes *d_first_k = taken(&from, wide), *d_middle = taken(&from, wide);
    lanes *y0 = taken(&from, n_y), *ym = taken(&from, n_y), *y1 = taken(&from, n_y), *z = taken(&from, 2 * n_y);
    lanes *dy0 = taken(&from, seen), *dym = taken(&from, seen), *dy1 = taken(&from, seen), *dz = taken(&from, 2 * seen);

    for (int64_t group = 0; group < todo->m; group += LANES) {
        int64_t who[LANES], count[LANES], longest = 0;
        EACH {
            const int64_t at = group + l < todo->m ? group + l : todo->m - 1;
            who[l] = todo->order[at];
            count[l] = todo->first[who[l] + 1] - todo->first[who[l]];
            if (count[l] > longest) longest = count[l];
        }
        for (int64_t i = 0; i < n_x; i++) EACH x[i][l] = of->initial[i];
        for (int64_t i = 0; i < of->n_started; i++) EACH x[of->started[i]][l] = todo->local[who[l] * n_local + i];
        for (int64_t i = 0; i < of->n_d; i++) EACH d[i][l] = todo->local[who[l] * n_local + of->n_started + i];
        memset(slope, 0, wide * sizeof(lanes));
        memset(d_k, 0, wide * sizeof(lanes));
        if (n_c)
            for (int64_t i = 0; i < of->n_started; i++) EACH slope[of->started[i] * n_c + of->n_free + i][l] = 1.0;
        start(&rate, of, todo, who, d);
        start(&output, of, todo, who, d);
        start(&alone, of, todo, who, d);

        for (int64_t step = 0; step < longest; step++) {
            lanes h;
            int still = 1, reported = 0, changed = 0;
            int64_t target[LANES];
            EACH {
                const int within = step < count[l];
                const int64_t row = todo->first[who[l]] + (within ? step : count[l] - 1);
                const double *node = todo->nodes + row * todo->n_data;
                h[l] = within ? node[0] : 0.0;
                target[l] = within && group + l < todo->m ? todo->target[row] : -1;
                reported |= target[l] >= 0;
                still &= h[l] == 0.0;
                for (int64_t i = 0; i < of->n_u; i++) {
                    before[i][l] = step ? at_start[i][l] : node[1 + i];
                    at_start[i][l] = node[1 + i];
                    changed |= before[i][l] != at_start[i][l];
                }
                for (int64_t i = 0; i < of->n_e; i++) {
                    at_start[of->n_u + i][l] = node[1 + of->n_u + i];
                    at_end[of->n_u + i][l] = node[1 + of->n_u + of->n_e + i];
                }
            }
            for (int64_t i = 0; i < of->n_u; i++) at_end[i] = at_middle[i] = at_start[i];
            for (int64_t i = of->n_u; i < n_s; i++) at_middle[i] = 0.5 * (at_start[i] + at_end[i]);
            if (changed && moved) {
                memcpy(before + of->n_u, at_start + of->n_u, of->n_e * sizeof(lanes));
                pass_edge(&alone, of, todo, x, before, at_start, jump, slope);
            }
            if (filters) { /* outputs at the start of the piece */
                evaluate(&output, of, x, at_start);
                for (int64_t o = 0; o < n_y; o++) y0[o] = RESULT(output, o);
                if (n_c) observe(of, &output, slope, dy0, 1);
            }
            memcpy(after, x, n_x * sizeof(lanes));
            if (filters) memcpy(middle, x, n_x * sizeof(lanes));
            if (filters && n_c) memcpy(d_middle, slope, wide * sizeof(lanes));
            if (!still) {
                static const double weights[4] = {1.0, 2.0, 2.0, 1.0}, shares[4] = {0.0, 0.5, 0.5, 1.0};
                for (int stage = 0; stage < 4; stage++) {
                    const double share = shares[stage];
                    const lanes part = share * h;
                    for (int64_t i = 0; i < n_x; i++) ahead[i] = stage ? x[i] + part * k[i] : x[i];
                    const lanes *tangent = slope;
                    if (stage && n_c) {
                        tangent = d_ahead;
                        for (int64_t i = 0; i < n_x; i++)
                            for (int32_t j = of->active_first[i]; j < of->active_first[i + 1]; j++) {
                                const int64_t at = i * n_c + of->active[j];
                                d_ahead[at] = slope[at] + part * d_k[at];
                            }
                    }
                    evaluate(&rate, of, ahead, stage == 0 ? at_start : stage == 3 ? at_end : at_middle);
                    for (int64_t i = 0; i < n_x; i++) {
                        k[i] = RESULT(rate, i);
                        total[i] = stage ? total[i] + weights[stage] * k[i] : k[i];
                    }
                    if (stage == 0) memcpy(first_k, k, n_x * sizeof(lanes));
                    if (!n_c) continue;
                    for (int64_t i = 0; i < n_x; i++)
                        for (int32_t j = of->active_first[i]; j < of->active_first[i + 1]; j++)
                            d_k[i * n_c + of->active[j]] = (lanes){0};
                    for (int64_t i = 0; i < of->by_rate.count; i++) {
                        const int32_t r = of->by_rate.rows[i], s = of->by_rate.columns[i];
                        const lanes j = RESULT(rate, n_x + i);
                        if (s >= n_x) {
                            d_k[r * n_c + s - n_x] += j;
                            continue;
                        }
                        for (int32_t a = of->active_first[s]; a < of->active_first[s + 1]; a++) {
                            const int32_t c = of->active[a];
                            d_k[r * n_c + c] += j * tangent[s * n_c + c];
                        }
                    }
                    for (int64_t i = 0; i < n_x; i++)
                        for (int32_t j = of->active_first[i]; j < of->active_first[i + 1]; j++) {
                            const int64_t at = i * n_c + of->active[j];
                            d_total[at] = stage ? d_total[at] + weights[stage] * d_k[at] : d_k[at];
                        }
                    if (stage == 0 && filters) memcpy(d_first_k, d_k, wide * sizeof(lanes));
                }
                const lanes sixth = h / 6.0, eighth = h / 8.0;
                for (int64_t i = 0; i < n_x; i++) {
                    after[i] = x[i] + sixth * total[i];
                    if (filters) middle[i] = 0.5 * (x[i] + after[i]) + eighth * (first_k[i] - k[i]);
                    if (!n_c) continue;
                    for (int32_t j = of->active_first[i]; j < of->active_first[i + 1]; j++) {
                        const int64_t at = i * n_c + of->active[j];
                        const lanes begun = slope[at];
                        slope[at] += sixth * d_total[at];
                        if (filters) d_middle[at] = 0.5 * (begun + slope[at]) + eighth * (d_first_k[at] - d_k[at]);
                    }
                }
                memcpy(x, after, n_x * sizeof(lanes));
            }
            if (filters) {
                evaluate(&output, of, middle, at_middle);
                for (int64_t o = 0; o < n_y; o++) ym[o] = RESULT(output, o);
                if (n_c) observe(of, &output, d_middle, dym, 1);
            }
            if (!filters && !reported) continue;
            evaluate(&output, of, x, at_end);
            for (int64_t o = 0; o < n_y; o++) y1[o] = RESULT(output, o);
            if (n_c) observe(of, &output, slope, dy1, !reported);
            pace at = {.w = 0.0};
            for (int64_t o = 0; o < n_y; o++) {
                if (of->filter[o] == 0.0) continue;
                if (at.w != of->filter[o]) at = paced(of->filter[o], &h);
                lanes *own = z + 2 * o, added, turned;
                if (step == 0) {
                    own[0] = y0[o];
                    own[1] = (lanes){0};
                }
                for (int32_t j = n_c ? of->seen_first[o] : 0; j < (n_c ? of->seen_first[o + 1] : 0); j++) {
                    const int64_t c = o * n_c + of->seen[j];
                    lanes *tangent = dz + 2 * c;
                    if (step == 0) {
                        tangent[0] = dy0[c];
                        tangent[1] = (lanes){0};
                    }
                    forced(&at, dy0 + c, dym + c, dy1 + c, &added, &turned);
                    const lanes first = at.e11 * tangent[0] + at.e12 * tangent[1] + added;
                    tangent[1] = at.e21 * tangent[0] + at.e22 * tangent[1] + turned;
                    tangent[0] = first;
                }
                forced(&at, y0 + o, ym + o, y1 + o, &added, &turned);
                const lanes first = at.e11 * own[0] + at.e12 * own[1] + added;
                own[1] = at.e21 * own[0] + at.e22 * own[1] + turned;
                own[0] = first;
            }
            EACH {
                if (target[l] < 0) continue;
                const int64_t row = (who[l] * todo->n + target[l]) * n_y;
                for (int64_t o = 0; o < n_y; o++) {
                    const int filtered = of->filter[o] != 0.0;
                    todo->y[row + o] = filtered ? z[2 * o][l] : y1[o][l];
                    double *into = todo->dy + (row + o) * n_c;
                    const double counted = todo->mask ? todo->mask[row + o] : 1.0;
                    if (n_c)
                        for (int32_t j = of->seen_first[o]; j < of->seen_first[o + 1]; j++) {
                            const int64_t c = of->seen[j];
                            into[c] = counted * (filtered ? dz[2 * (o * n_c + c)][l] : dy1[o * n_c + c][l]);
                        }
                }
            }
        }
    }
    free(memory);
    return 0;
}
