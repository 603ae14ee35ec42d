/* part: grid */
struct grid {
    const double *levels[RIG_AXES]; /* cells + 1 of each, ascending, m or rad */
    int cells[RIG_AXES], strides[RIG_AXES];
    const double *values; /* RIG_AXES of each vertex, m or rad */
};

/* The lowest vertex of the cell of x, and the place in the cell, 0 to 1; beyond the levels that on their edge. */
static int grid_cell(const struct grid *g, const double x[RIG_AXES], double t[RIG_AXES])
{
    int vertex = 0;
    for (int i = 0; i < RIG_AXES; i++) {
        const int cells = g->cells[i];
        const double *level = g->levels[i], inner = fmin(fmax(x[i], level[0]), level[cells]);
        int cell = 0;
        for (int j = 1; j < cells; j++)
            cell += inner >= level[j];
        t[i] = (inner - level[cell]) / (level[cell + 1] - level[cell]);
        vertex += cell * g->strides[i];
    }
    return vertex;
}

/* part: simplex */
/* Simplices of a cell: vertices met along the axes, the largest place first (Kuhn, 1960). */
static void add_simplex(const struct grid *g, const double x[RIG_AXES], double weight, double out[RIG_AXES])
{
    double t[RIG_AXES], ranked[RIG_AXES + 1] = {0.0};
    int steps[RIG_AXES] = {0};
    int vertex = grid_cell(g, x, t);
    for (int i = 0; i < RIG_AXES; i++) {
        int rank = 0;
        for (int j = 0; j < i; j++)
            rank += t[j] >= t[i];
        for (int j = i + 1; j < RIG_AXES; j++)
            rank += t[j] > t[i];
        ranked[rank] = t[i];
        steps[rank] = g->strides[i];
    }
    for (int k = 0; k < RIG_AXES; k++)
        out[k] += weight * (1.0 - ranked[0]) * g->values[RIG_AXES * vertex + k];
    for (int i = 0; i < RIG_AXES; i++) {
        vertex += steps[i];
        for (int k = 0; k < RIG_AXES; k++)
            out[k] += weight * (ranked[i] - ranked[i + 1]) * g->values[RIG_AXES * vertex + k];
    }
}

/* part: linear */
/* Linear along each axis: all vertices of a cell. */
static void add_linear(const struct grid *g, const double x[RIG_AXES], double weight, double out[RIG_AXES])
{
    double t[RIG_AXES];
    const int lowest = grid_cell(g, x, t);
    for (int corner = 0; corner < 1 << RIG_AXES; corner++) {
        int vertex = lowest;
        double share = weight;
        for (int i = 0; i < RIG_AXES; i++) {
            const int upper = corner >> i & 1;
            vertex += upper * g->strides[i];
            share *= upper ? t[i] : 1.0 - t[i];
        }
        for (int k = 0; k < RIG_AXES; k++)
            out[k] += share * g->values[RIG_AXES * vertex + k];
    }
}

/* part: axes */
struct axis_sum {
    int count;
    const double *knots;        /* count of each axis */
    const double *coefficients; /* RIG_AXES of each knot, axis after axis */
};

/* A sum of one piecewise linear function per axis. */
static void add_axes(const struct axis_sum *f, const double x[RIG_AXES], double weight, double out[RIG_AXES])
{
    for (int i = 0; i < RIG_AXES; i++) {
        const double *knots = f->knots + i * f->count;
        const double inner = fmin(fmax(x[i], knots[0]), knots[f->count - 1]);
        int cell = 0;
        for (int j = 1; j < f->count - 1; j++)
            cell += inner >= knots[j];
        const double t = (inner - knots[cell]) / (knots[cell + 1] - knots[cell]);
        const double *low = f->coefficients + RIG_AXES * (i * f->count + cell);
        for (int k = 0; k < RIG_AXES; k++)
            out[k] += weight * ((1.0 - t) * low[k] + t * low[RIG_AXES + k]);
    }
}

/* part: polynomial */
struct polynomial {
    int terms;
    const double *low, *high;
    const int *powers;          /* RIG_AXES of each term */
    const double *coefficients; /* RIG_AXES of each term */
};

/* A polynomial of coordinates that go from -1 to 1 over the box of the samples. */
static void add_polynomial(const struct polynomial *f, const double x[RIG_AXES], double weight, double out[RIG_AXES])
{
    double u[RIG_AXES];
    for (int i = 0; i < RIG_AXES; i++) {
        const double inner = fmin(fmax(x[i], f->low[i]), f->high[i]);
        u[i] = (2.0 * inner - f->low[i] - f->high[i]) / (f->high[i] - f->low[i]);
    }
    for (int term = 0; term < f->terms; term++) {
        double product = weight;
        for (int i = 0; i < RIG_AXES; i++)
            for (int power = f->powers[RIG_AXES * term + i]; power > 0; power--)
                product *= u[i];
        for (int k = 0; k < RIG_AXES; k++)
            out[k] += product * f->coefficients[RIG_AXES * term + k];
    }
}

/* part: radial */
struct radial {
    int axis, count;
    double own, whole; /* 1 / (2 length^2), in half strokes, of the function of the axis and of that of all */
    const double *centre, *half;
    const double *samples; /* of each its scaled configuration, and its weight in either function (m or rad) */
};

/* A Gaussian process: a sum over its samples. */
static void add_radial(const struct radial *f, const double x[RIG_AXES], double weight, double out[RIG_AXES])
{
    double scaled[RIG_AXES], sum = 0.0;
    for (int i = 0; i < RIG_AXES; i++)
        scaled[i] = (x[i] - f->centre[i]) / f->half[i];
    for (int n = 0; n < f->count; n++) {
        const double *sample = f->samples + (RIG_AXES + 2) * n;
        const double off = scaled[f->axis] - sample[f->axis];
        double square = 0.0;
        for (int i = 0; i < RIG_AXES; i++)
            square += (scaled[i] - sample[i]) * (scaled[i] - sample[i]);
        sum += sample[RIG_AXES] * exp(-f->own * off * off) + sample[RIG_AXES + 1] * exp(-f->whole * square);
    }
    out[f->axis] += weight * sum;
}

/* part: within */
/* 1 within a part of the space, 0 far from it, fading between. */
static double within(const double x[RIG_AXES], const double low[RIG_AXES], const double high[RIG_AXES], const double fade[RIG_AXES])
{
    double weight = 1.0;
    for (int i = 0; i < RIG_AXES; i++) {
        const double far = fmin(fmax(fmax(low[i] - x[i], x[i] - high[i]), 0.0) / fade[i], 1.0);
        weight *= (1.0 - far) * (1.0 - far) * (1.0 + 2.0 * far);
    }
    return weight;
}
