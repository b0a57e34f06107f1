/* Inverse and forward kinematics of one machine, between poses and readings, in C99; needs <math.h>.

   Poses are rigid transforms T_base_platform: three rows of a rotation and a position, 12 numbers,
   [1] and [m]. Readings are in [rad] or [m], in the order of machine_reading_names. Joints of all
   legs stand one after the other, MACHINE_JOINTS of them. Influences are the quantities that terms
   depend on, NAN for an unknown one; NULL for none.

       double T[12], readings[MACHINE_READINGS], joints[MACHINE_JOINTS];
       machine_pose(machine_home, T);
       int leg = machine_inverse(T, NULL, NULL, readings, joints);   0, or number of a leg without solution
       int lost = machine_forward(readings, NULL, NULL, NULL, T, joints);   0, or why no pose was found

   Both return -1 and write nothing if an argument is not finite or above 1e12, or T no rigid transform.
*/
#ifndef MACHINE_KINEMATICS_H
#define MACHINE_KINEMATICS_H

#include <math.h>
#include <stddef.h>

/* SIZES */

typedef const char *machine_text;
typedef double machine_positions[MACHINE_MOST];
typedef struct { int source; double rate; } machine_rate;
typedef struct { int turns; double axis[3]; int n_rates; const machine_rate *rates; double behind[12]; } machine_move;
typedef struct { double start[12]; int n_moves; const machine_move *moves; } machine_chain;
typedef struct { double amplitude; int place; double a, b; int exponent; } machine_term;
typedef struct { double slope, start; int n_terms; const machine_term *terms; } machine_sensor;
typedef struct { int n_terms; const machine_term *terms; } machine_deformation;
typedef struct { int n_rows; const int *rows; int loop; machine_chain tip, met; } machine_end;
typedef struct {
    const char *name;
    int n_joints, n_active, n_passive, n_unknown, n_sensors, n_deformations, n_ends, n_starts, rows, arm;
    double size, mode;
    const machine_text *joints;
    const int *active, *passive, *unknown; /* unknown: active joints first */
    const machine_positions *starts;
    int turns[MACHINE_MOST];
    double home[MACHINE_MOST], limits[MACHINE_MOST][2];
    const machine_sensor *sensors;
    const machine_deformation *deformations;
    const machine_end *ends;
} machine_leg;
typedef struct { double mass; machine_chain chain; } machine_body;
typedef struct { int place, source; } machine_load_column;
typedef struct {
    double gravity[3];
    int width, n_active, n_sensors, n_bodies, n_columns;
    const int *active;
    const machine_sensor *sensors;
    const machine_body *bodies;
    const machine_load_column *columns;
} machine_gravity;
typedef struct { double low[MACHINE_DOF], high[MACHINE_DOF]; int count, n_twists; const double *twists; } machine_corrections;

/* TABLES */

enum { MACHINE_COLUMNS = MACHINE_MOST + MACHINE_DOF + 1 };
typedef double machine_row[MACHINE_COLUMNS];

static inline double machine_dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static inline void machine_cross(const double *a, const double *b, double *c) {
    c[0] = a[1] * b[2] - a[2] * b[1]; c[1] = a[2] * b[0] - a[0] * b[2]; c[2] = a[0] * b[1] - a[1] * b[0];
}

/* the larger of two numbers; NAN if one is NAN */
static inline double machine_larger(double a, double b) { return b > a || isnan(b) ? b : a; }

/* whether numbers are finite and not too large to compute with; NULL for none */
static inline int machine_bounded(const double *values, int n) {
    double largest = 0.0;
    for (int i = 0; values && i < n; i++) largest = machine_larger(largest, fabs(values[i]));
    return largest <= 1e12;
}

/* whether influences are bounded or unknown, NAN */
static inline int machine_known(const double *influences) {
    int bounded = 1;
    for (int i = 0; influences && i < MACHINE_INFLUENCES; i++) bounded &= !(fabs(influences[i]) > 1e12);
    return bounded;
}

/* whether 12 numbers are a rigid transform: each row of the rotation follows of two */
static inline int machine_rigid(const double *T) {
    double x[3], z[3], off = fabs(machine_dot(T, T) - 1.0);
    machine_cross(T, T + 4, z); machine_cross(T + 4, T + 8, x);
    for (int i = 0; i < 3; i++) off = machine_larger(off, machine_larger(fabs(x[i] - T[i]), fabs(z[i] - T[8 + i])));
    return off <= 1e-3 && machine_bounded(T, 12);
}

static inline void machine_copy(const double *from, double *to, int n) { for (int i = 0; i < n; i++) to[i] = from[i]; }

/* A B of two rigid transforms; the result may be A or B */
static inline void machine_compose(const double *A, const double *B, double *AB) {
    double product[12];
    for (int i = 0; i < 12; i += 4) {
        for (int j = 0; j < 4; j++) product[i + j] = A[i] * B[j] + A[i + 1] * B[4 + j] + A[i + 2] * B[8 + j];
        product[i + 3] += A[i + 3];
    }
    machine_copy(product, AB, 12);
}

static inline void machine_inverted(const double *T, double *inverse) {
    double R[12];
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) R[4 * i + j] = T[4 * j + i];
        R[4 * i + 3] = -(T[i] * T[3] + T[4 + i] * T[7] + T[8 + i] * T[11]);
    }
    machine_copy(R, inverse, 12);
}

static inline void machine_turned(const double *axis, double angle, double *T) {
    double x = axis[0], y = axis[1], z = axis[2], c = cos(angle), s = sin(angle), d = 1.0 - c;
    double turn[12] = {c + x * x * d, x * y * d - z * s, x * z * d + y * s, 0,
                       y * x * d + z * s, c + y * y * d, y * z * d - x * s, 0,
                       z * x * d - y * s, z * y * d + x * s, c + z * z * d, 0};
    machine_copy(turn, T, 12);
}

static inline void machine_rotated(const double *T, const double *vector, double *turned) {
    for (int i = 0; i < 3; i++) turned[i] = machine_dot(T + 4 * i, vector);
}

/* rotation vector, axis times angle, of a rotation */
static inline void machine_rotation_vector(const double *T, double *vector) {
    double skew[3] = {T[9] - T[6], T[2] - T[8], T[4] - T[1]};
    double twice = sqrt(machine_dot(skew, skew)), angle = atan2(twice, T[0] + T[5] + T[10] - 1.0);
    double share = twice > 1e-7 ? angle / twice : 0.5;
    for (int i = 0; i < 3; i++) vector[i] = share * skew[i];
    if (twice > 1e-7 || angle < 1.0) return;
    int i = T[0] > T[5] ? (T[0] > T[10] ? 0 : 2) : (T[5] > T[10] ? 1 : 2); /* half a turn */
    double size = sqrt(fmax(T[5 * i] + 1.0, 0.0) / 2.0);
    for (int j = 0; j < 3; j++) vector[j] = angle * (j == i ? size : (T[4 * i + j] + T[4 * j + i]) / (4.0 * size));
}

static inline double machine_near(double angle, double centre) { return centre + atan2(sin(angle - centre), cos(angle - centre)); }

/* the pose of the platform's coordinates, and back */
static inline void machine_pose(const double *coordinates, double *T) {
    static const double unit[12] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0}, y[3] = {0, 1, 0}, z[3] = {0, 0, 1};
    const double *turns = coordinates + MACHINE_LENGTHS;
    double turn[12];
    machine_copy(unit, T, 12);
    for (int i = 0; i < MACHINE_LENGTHS; i++) T[4 * i + 3] = coordinates[i];
    if (MACHINE_TURNS == 1) { machine_turned(machine_turn_axes[0], turns[0], turn); machine_compose(T, turn, T); }
    if (MACHINE_TURNS == 3) {
        machine_turned(z, turns[0], turn); machine_compose(T, turn, T);
        machine_turned(y, turns[1], turn); machine_compose(T, turn, T);
        machine_turned(z, turns[2] - turns[0], turn); machine_compose(T, turn, T);
    }
}

static inline void machine_coordinates(const double *T, double *coordinates) {
    double *turns = coordinates + MACHINE_LENGTHS;
    for (int i = 0; i < MACHINE_LENGTHS; i++) coordinates[i] = T[4 * i + 3];
    if (MACHINE_TURNS == 1) {
        int i = machine_turn_axes[0][0] != 0.0 ? 0 : machine_turn_axes[0][1] != 0.0 ? 1 : 2, j = (i + 1) % 3, k = (i + 2) % 3;
        turns[0] = atan2(T[4 * k + j], T[4 * j + j]);
    }
    if (MACHINE_TURNS == 3) {
        double flat = hypot(T[2], T[6]);
        turns[0] = flat > 1e-13 ? atan2(T[6], T[2]) : 0.0;
        turns[1] = atan2(flat, T[10]);
        turns[2] = atan2(T[4] - T[1], T[0] + T[5]);
        if (flat <= 1e-13 && T[10] < 0.0) { turns[0] = atan2(-T[1], -T[0]) / 2.0; turns[2] = 0.0; }
    }
}

/* T_base_platform of a pose of the tool in the frame of the measurements, and back */
static inline void machine_in_base(const double *tool_pose, double *T) {
    double back[12];
    machine_inverted(machine_tool, back); machine_compose(tool_pose, back, T);
    machine_inverted(machine_frame, back); machine_compose(back, T, T);
}

static inline void machine_in_frame(const double *T, double *tool_pose) {
    machine_compose(machine_frame, T, tool_pose); machine_compose(tool_pose, machine_tool, tool_pose);
}

/* T moved by a twist in the platform's freedoms, base axes */
static inline void machine_displaced(const double *T, const double *twist, double *moved) {
    double full[6] = {0}, by[12], size;
    for (int i = 0; i < MACHINE_DOF; i++) full[machine_freedoms[i]] = twist[i];
    size = sqrt(machine_dot(full + 3, full + 3));
    for (int i = 3; i < 6; i++) full[i] /= size > 0.0 ? size : 1.0;
    machine_turned(full + 3, size, by);
    for (int i = 0; i < 3; i++) full[i] += T[4 * i + 3];
    machine_compose(by, T, moved);
    for (int i = 0; i < 3; i++) moved[4 * i + 3] = full[i];
}

#ifdef MACHINE_GRID
/* the pose to command to a controller with other geometry; the result may be T */
static inline void machine_corrected(const double *T, double *commanded) {
    double home[12], back[12], offset[6], share[MACHINE_DOF], twist[MACHINE_DOF] = {0};
    int cell[MACHINE_DOF];
    machine_pose(machine_home, home); machine_inverted(home, back); machine_compose(T, back, back);
    machine_rotation_vector(back, offset + 3);
    for (int i = 0; i < 3; i++) offset[i] = T[4 * i + 3] - home[4 * i + 3];
    for (int i = 0; i < MACHINE_DOF; i++) {
        double at = (offset[machine_freedoms[i]] - machine_grid.low[i]) / (machine_grid.high[i] - machine_grid.low[i]);
        at = (at < 0.0 ? 0.0 : at > 1.0 ? 1.0 : at) * (MACHINE_GRID - 1);
        cell[i] = at < MACHINE_GRID - 2 ? (int)at : MACHINE_GRID - 2;
        share[i] = at - cell[i];
    }
    for (int corner = 0; corner < 1 << MACHINE_DOF; corner++) {
        double weight = 1.0;
        int node = 0;
        for (int i = 0; i < MACHINE_DOF; i++) {
            int side = corner >> i & 1;
            weight *= side ? share[i] : 1.0 - share[i];
            node = node * MACHINE_GRID + cell[i] + side;
        }
        for (int i = 0; i < MACHINE_DOF; i++) twist[i] += weight * machine_grid.twists[node * MACHINE_DOF + i];
    }
    machine_displaced(T, twist, commanded);
}
#endif

typedef struct { const machine_move *move; double axis[3], point[3]; } machine_joint;

/* the pose of the tip of a chain, and its joints there */
static inline void machine_along(const machine_chain *chain, const double *values, double *T, machine_joint *joints) {
    machine_copy(chain->start, T, 12);
    for (int i = 0; i < chain->n_moves; i++) {
        const machine_move *move = chain->moves + i;
        double position = 0.0, motion[12];
        for (int j = 0; j < move->n_rates; j++) position += move->rates[j].rate * values[move->rates[j].source];
        if (joints) {
            joints[i].move = move;
            machine_rotated(T, move->axis, joints[i].axis);
            for (int j = 0; j < 3; j++) joints[i].point[j] = T[4 * j + 3];
        }
        if (move->turns) {
            machine_turned(move->axis, position, motion); machine_compose(T, motion, T);
        } else {
            double shift[3];
            machine_rotated(T, move->axis, shift);
            for (int j = 0; j < 3; j++) T[4 * j + 3] += position * shift[j];
        }
        machine_compose(T, move->behind, T);
    }
}

/* velocity at a place, and spin, by a joint's motion */
static inline void machine_twist(const machine_joint *joint, const double *place, double *twist) {
    static const double still[3] = {0, 0, 0};
    double arm[3];
    for (int i = 0; i < 3; i++) arm[i] = place[i] - joint->point[i];
    if (joint->move->turns) machine_cross(joint->axis, arm, twist); else machine_copy(joint->axis, twist, 3);
    machine_copy(joint->move->turns ? joint->axis : still, twist + 3, 3);
}

/* rows of a leg: derivatives by its unknown joints, then by the pose's twist, and minus the gap, [m] */
static inline double machine_closure(const machine_leg *leg, const double *T, const double *values, int first, machine_row *A) {
    int n = leg->n_unknown, row = 0;
    double largest = 0.0;
    for (int e = 0; e < leg->n_ends; e++) {
        const machine_end *end = leg->ends + e;
        machine_joint joints[2][MACHINE_MOVES];
        double tip[12], met[12], back[12], place[3], gap[3], turn[3], arm[3];
        double columns[6][MACHINE_MOST] = {{0}};
        machine_along(&end->tip, values, tip, joints[0]);
        machine_along(&end->met, values, met, joints[1]);
        if (!end->loop) machine_compose(T, met, met);
        for (int i = 0; i < 3; i++) { place[i] = tip[4 * i + 3]; gap[i] = place[i] - met[4 * i + 3]; arm[i] = met[4 * i + 3] - T[4 * i + 3]; }
        machine_inverted(met, back); machine_compose(tip, back, back); machine_rotation_vector(back, turn);
        for (int side = 0; side <= end->loop; side++)
            for (int i = 0; i < (side ? end->met.n_moves : end->tip.n_moves); i++) {
                double twist[6];
                const machine_move *move = joints[side][i].move;
                machine_twist(&joints[side][i], place, twist);
                for (int j = 0; j < move->n_rates; j++) {
                    if (move->rates[j].source >= leg->n_joints) continue;
                    for (int k = 0; k < 6; k++) columns[k][move->rates[j].source] += (side ? -1.0 : 1.0) * move->rates[j].rate * twist[k];
                }
            }
        for (int r = 0; r < end->n_rows; r++, row++) {
            int angular = end->rows[r] > 2;
            double scale = angular ? leg->size : 1.0, axis[3];
            for (int i = 0; i < 3; i++) axis[i] = end->loop ? met[4 * i + end->rows[r] % 3] : (double)(end->rows[r] % 3 == i);
            for (int j = first; j < n; j++) {
                double sum = 0.0;
                for (int i = 0; i < 3; i++) sum += axis[i] * columns[3 * angular + i][leg->unknown[j]];
                A[row][j - first] = scale * sum;
            }
            for (int j = 0; j < MACHINE_DOF; j++) {
                double unit[3] = {0, 0, 0}, moved[3];
                int turns = machine_freedoms[j] > 2;
                unit[machine_freedoms[j] % 3] = 1.0;
                if (turns && !angular) machine_cross(unit, arm, moved); else machine_copy(unit, moved, 3);
                A[row][n - first + j] = end->loop || (angular && !turns) ? 0.0 : -scale * machine_dot(axis, moved);
            }
            double miss = scale * machine_dot(axis, angular ? turn : gap);
            A[row][n - first + MACHINE_DOF] = -miss;
            largest = machine_larger(largest, fabs(miss));
        }
    }
    return largest;
}

/* reflect rows of A so that its first columns are a triangle; the sign of their determinant */
static inline double machine_triangle(machine_row *A, int rows, int columns, int width) {
    double sign = 1.0;
    for (int k = 0; k < columns && k < rows; k++) {
        double size = 0.0, v[MACHINE_TALL];
        for (int i = k; i < rows; i++) size += A[i][k] * A[i][k];
        size = sqrt(size);
        if (size == 0.0 || k == rows - 1) { sign *= copysign(1.0, A[k][k]); continue; }
        double pivot = A[k][k], end = -copysign(size, pivot), half = size * (size + fabs(pivot));
        for (int i = k; i < rows; i++) v[i] = A[i][k];
        v[k] = pivot - end;
        sign *= -copysign(1.0, end);
        for (int j = k; j < width; j++) {
            double share = 0.0;
            for (int i = k; i < rows; i++) share += v[i] * A[i][j];
            for (int i = k; i < rows; i++) A[i][j] -= share / half * v[i];
        }
    }
    return sign;
}

static inline void machine_back(machine_row *A, int rows, int n, int last, double *x) {
    for (int i = 0; i < n; i++) x[i] = 0.0;
    for (int i = (n < rows ? n : rows) - 1; i >= 0; i--) {
        double rest = A[i][last];
        for (int j = i + 1; j < n; j++) rest -= A[i][j] * x[j];
        x[i] = A[i][i] != 0.0 ? rest / A[i][i] : 0.0;
    }
}

/* a step of joints that closes a leg best, the shortest if there are more joints than rows */
static inline void machine_step(const machine_leg *leg, machine_row *A, double *step) {
    int n = leg->n_unknown, rows = leg->rows;
    double largest = 0.0;
    for (int i = 0; i < rows; i++) {
        A[i][n] = A[i][n + MACHINE_DOF];
        for (int j = 0; j < n; j++) largest = fmax(largest, fabs(A[i][j]));
    }
    for (int i = 0; rows < n && i < n; i++)
        for (int j = 0; j <= n; j++) A[rows + i][j] = i == j ? 1e-6 * largest : 0.0;
    if (rows < n) rows += n;
    machine_triangle(A, rows, n, n + 1);
    machine_back(A, rows, n, n, step);
}

/* the largest step, [rad] or over the leg's size */
static inline double machine_length(const machine_leg *leg, int first, const double *step) {
    double largest = 0.0;
    for (int j = first; j < leg->n_unknown; j++)
        largest = machine_larger(largest, fabs(step[j - first]) / (leg->turns[leg->unknown[j]] ? 1.0 : leg->size));
    return largest;
}

/* the working mode: the sign of the determinant by all joints */
static inline double machine_mode(const machine_leg *leg, const double *T, const double *values) {
    machine_row A[MACHINE_TALL];
    int n = leg->n_unknown;
    if (n != leg->rows || !leg->n_passive) return 1.0;
    machine_closure(leg, T, values, 0, A);
    return machine_triangle(A, n, n, n);
}

static inline double machine_basis(const machine_term *term, double value, int slope) {
    if (!isfinite(value)) return 0.0;
    if (term->exponent == 0) return slope ? term->a * cos(term->a * value + term->b) : sin(term->a * value + term->b);
    double relative = (value - term->b) / term->a;
    return slope ? term->exponent / term->a * pow(relative, term->exponent - 1) : pow(relative, term->exponent);
}

static inline double machine_position(const machine_sensor *sensor, double reading, const double *known) {
    double position = sensor->slope * reading + sensor->start;
    for (int i = 0; i < sensor->n_terms; i++) {
        const machine_term *term = sensor->terms + i;
        position += term->amplitude * machine_basis(term, term->place < 0 ? reading : known[term->place], 0);
    }
    return position;
}

static inline int machine_reading(const machine_sensor *sensor, double position, const double *known, double *reading) {
    double step = 0.0;
    *reading = (position - sensor->start) / sensor->slope;
    for (int k = 0; sensor->n_terms && k < 50; k++) {
        double slope = sensor->slope;
        for (int i = 0; i < sensor->n_terms; i++)
            if (sensor->terms[i].place < 0) slope += sensor->terms[i].amplitude * machine_basis(sensor->terms + i, *reading, 1);
        step = (position - machine_position(sensor, *reading, known)) / slope;
        *reading += step;
        if (fabs(step) <= 1e-15 * fmax(1.0, fabs(*reading))) break;
    }
    return fabs(step) <= 1e-8 * fmax(1.0, fabs(*reading));
}

static inline void machine_bend(const machine_leg *leg, const double *known, double *bent) {
    for (int i = 0; i < leg->n_deformations; i++) {
        bent[i] = 0.0;
        for (int j = 0; j < leg->deformations[i].n_terms; j++) {
            const machine_term *term = leg->deformations[i].terms + j;
            bent[i] += term->amplitude * machine_basis(term, known[term->place], 0);
        }
    }
}

/* influences; an arm's gravity loads, as drawn, are computed where not known */
static inline void machine_know(const double *influences, const double *readings, double *known) {
    for (int i = 0; i <= MACHINE_INFLUENCES; i++) known[i] = influences && i < MACHINE_INFLUENCES ? influences[i] : NAN;
    if (!machine_load.n_bodies) return;
    double q[MACHINE_LOAD_WIDTH] = {0}, weights[MACHINE_LOAD_WIDTH] = {0};
    for (int i = 0; i < machine_load.n_active; i++) q[machine_load.active[i]] = machine_position(machine_load.sensors + i, readings[i], known);
    for (int b = 0; b < machine_load.n_bodies; b++) {
        machine_joint joints[MACHINE_MOVES];
        const machine_chain *chain = &machine_load.bodies[b].chain;
        double T[12], twist[6];
        machine_along(chain, q, T, joints);
        for (int i = 0; i < chain->n_moves; i++) {
            machine_twist(joints + i, (double[3]){T[3], T[7], T[11]}, twist);
            double power = machine_load.bodies[b].mass * machine_dot(machine_load.gravity, twist);
            for (int j = 0; j < chain->moves[i].n_rates; j++) weights[chain->moves[i].rates[j].source] += chain->moves[i].rates[j].rate * power;
        }
    }
    for (int i = 0; i < machine_load.n_columns; i++) {
        const machine_load_column *column = machine_load.columns + i;
        if (!isfinite(known[column->place])) known[column->place] = weights[column->source];
    }
}

/* the number of a leg's joints outside their limits */
static inline int machine_outside(const machine_leg *leg, const double *joints) {
    int count = 0;
    for (int i = 0; i < leg->n_joints; i++) count += !(joints[i] >= leg->limits[i][0] - 1e-9 && joints[i] <= leg->limits[i][1] + 1e-9);
    return count;
}

/* joints of a leg by Newton's method from their present positions; whether they close it in its mode */
static inline int machine_solve(const machine_leg *leg, const double *T, const double *near, double *values) {
    double step[MACHINE_MOST];
    machine_row A[MACHINE_TALL];
    for (int k = 0; k < 40; k++) {
        machine_closure(leg, T, values, 0, A);
        machine_step(leg, A, step);
        double length = machine_length(leg, 0, step), share = fmin(1.0, 0.3 / fmax(length, 0.3));
        for (int j = 0; j < leg->n_unknown; j++) values[leg->unknown[j]] += share * step[j];
        if (!(length > 1e-10)) break;
        for (int i = 0; !near && k < 20 && i < leg->n_joints; i++) values[i] = fmax(leg->limits[i][0], fmin(leg->limits[i][1], values[i]));
    }
    for (int i = 0; i < leg->n_joints; i++) {
        double low = leg->limits[i][0] - 1e-9, high = leg->limits[i][1] + 1e-9, full = 2.0 * acos(-1.0);
        if (!leg->turns[i] || !isfinite(values[i])) continue;
        values[i] = machine_near(values[i], near ? near[i] : leg->home[i]);
        if (near || (low <= values[i] && values[i] <= high)) continue;
        double back = low + (values[i] - low) - full * floor((values[i] - low) / full);
        if (back <= high) values[i] = back;
    }
    return machine_closure(leg, T, values, 0, A) <= 1e-10 * leg->size && machine_mode(leg, T, values) == leg->mode;
}

/* joints of a leg near given ones, or from starts, the nearest first: the first within limits that
   close it, if there are none the first at all */
static inline int machine_close(const machine_leg *leg, const double *T, const double *near, double *values) {
    double apart[MACHINE_STARTS] = {0}, beyond[MACHINE_MOST];
    int best = 0;
    if (near) { machine_copy(near, values, leg->n_joints); return machine_solve(leg, T, near, values); }
    for (int s = 0; s < MACHINE_STARTS; s++) /* |R - R'|^2 is twice the squared angle */
        for (int i = 0; i < 12; i++) apart[s] += (i % 4 == 3 ? 1.0 : 0.5 * machine_size * machine_size) * pow(T[i] - machine_starts[s][i], 2.0);
    for (int k = 0; k < MACHINE_STARTS; k++) {
        int start = 0;
        for (int s = 1; s < MACHINE_STARTS; s++) start = apart[s] < apart[start] ? s : start;
        apart[start] = INFINITY;
        machine_copy(leg->starts[start], values, leg->n_joints);
        int closed = machine_solve(leg, T, NULL, values);
        if (closed && !machine_outside(leg, values)) return 1;
        if (closed && !best) { best = 1; machine_copy(values, beyond, leg->n_joints); }
    }
    machine_copy(best ? beyond : leg->home, values, leg->n_joints);
    return best;
}

static inline int machine_inverse_at(const double *T, const double *known, const double *near, double *readings, double *joints) {
    int lost = 0, row = 0, start = 0;
    for (int l = 0; l < MACHINE_LEGS; l++) {
        const machine_leg *leg = machine_legs + l;
        double values[MACHINE_MOST] = {0};
        machine_bend(leg, known, values + leg->n_joints);
        int reached = machine_close(leg, T, near ? near + start : NULL, values);
        machine_copy(values, joints + start, leg->n_joints);
        for (int j = 0; j < leg->n_active; j++, row++)
            reached &= machine_reading(leg->sensors + j, values[leg->unknown[j]], known, readings + row) && isfinite(readings[row]);
        if (!reached && !lost) lost = l + 1;
        start += leg->n_joints;
    }
    return lost;
}

/* readings and joints of a pose, near given joints or in the working modes of home: 0, or a leg that
   does not reach, counted from 1; -1 for arguments without meaning */
static inline int machine_inverse(const double *T, const double *influences, const double *near, double *readings, double *joints) {
    double known[MACHINE_INFLUENCES + 1], before[MACHINE_READINGS], last[MACHINE_JOINTS];
    if (!machine_rigid(T) || !machine_bounded(near, MACHINE_JOINTS) || !machine_known(influences)) return -1;
    for (int i = 0; i <= MACHINE_INFLUENCES; i++) known[i] = influences && i < MACHINE_INFLUENCES ? influences[i] : NAN;
    int lost = machine_inverse_at(T, known, near, readings, joints);
    for (int k = 0; machine_load.n_bodies && k < 20; k++) {
        double change = 0.0;
        machine_copy(readings, before, MACHINE_READINGS);
        machine_know(influences, readings, known);
        if (!lost && !near) { machine_copy(joints, last, MACHINE_JOINTS); near = last; }
        lost = machine_inverse_at(T, known, near, readings, joints);
        for (int i = 0; i < MACHINE_READINGS; i++) change = fmax(change, fabs(readings[i] - before[i]));
        if (change <= 1e-10) break;
    }
    return lost;
}

static inline int machine_forward_at(const double *readings, const double *known, double *T, double *joints) {
    double values[MACHINE_LEGS][MACHINE_MOST], twist[MACHINE_DOF], moved = 1.0, sign = 0.0, gaps = 0.0;
    machine_row reduced[MACHINE_LEGS][MACHINE_TALL], rows[MACHINE_REDUCED];
    int row = 0, start = 0, count = 0;
    for (int l = 0; l < MACHINE_LEGS; start += machine_legs[l++].n_joints) {
        const machine_leg *leg = machine_legs + l;
        double place[12];
        machine_copy(joints + start, values[l], leg->n_joints);
        for (int j = 0; j < leg->n_active; j++, row++) values[l][leg->unknown[j]] = machine_position(leg->sensors + j, readings[row], known);
        machine_bend(leg, known, values[l] + leg->n_joints);
        if (leg->arm) {
            machine_along(&leg->ends[0].met, values[l], place, NULL); machine_inverted(place, place);
            machine_along(&leg->ends[0].tip, values[l], T, NULL); machine_compose(T, place, T);
        }
    }
    for (int k = 0; k < 40; k++) {
        sign = 1.0; count = 0;
        for (int l = 0; l < MACHINE_LEGS; l++) {
            const machine_leg *leg = machine_legs + l;
            int p = leg->n_passive;
            machine_closure(leg, T, values[l], leg->n_active, reduced[l]);
            sign *= machine_triangle(reduced[l], leg->rows, p, p + MACHINE_DOF + 1);
            for (int i = p; i < leg->rows; i++, count++)
                machine_copy(reduced[l][i] + p, rows[count], MACHINE_DOF + 1);
        }
        sign *= machine_triangle(rows, count, MACHINE_DOF, MACHINE_DOF + 1);
        machine_back(rows, count, MACHINE_DOF, MACHINE_DOF, twist);
        moved = 0.0;
        for (int j = 0; j < MACHINE_DOF; j++) moved = machine_larger(moved, fabs(twist[j]) / (j < MACHINE_LENGTHS ? machine_size : 1.0));
        double share = fmin(1.0, 0.3 / fmax(moved, 0.3)), step[MACHINE_MOST];
        for (int l = 0; l < MACHINE_LEGS; l++) {
            const machine_leg *leg = machine_legs + l;
            int p = leg->n_passive, last = p + MACHINE_DOF;
            for (int i = 0; i < p && i < leg->rows; i++)
                for (int j = 0; j < MACHINE_DOF; j++) reduced[l][i][last] -= share * reduced[l][i][p + j] * twist[j];
            machine_back(reduced[l], leg->rows, p, last, step);
            moved = machine_larger(moved, machine_length(leg, leg->n_active, step));
            for (int j = 0; j < p; j++) values[l][leg->unknown[leg->n_active + j]] += step[j];
        }
        for (int j = 0; j < MACHINE_DOF; j++) twist[j] *= share;
        machine_displaced(T, twist, T);
        if (!(moved > 1e-10)) break;
    }
    if (!(moved <= 1e-10)) return 1;
    int in_mode = count > MACHINE_DOF || sign == machine_assembly;
    machine_row A[MACHINE_TALL];
    start = 0;
    for (int l = 0; l < MACHINE_LEGS; start += machine_legs[l++].n_joints) {
        gaps = machine_larger(gaps, machine_closure(machine_legs + l, T, values[l], 0, A));
        in_mode &= machine_mode(machine_legs + l, T, values[l]) == machine_legs[l].mode;
        machine_copy(values[l], joints + start, machine_legs[l].n_joints);
    }
    if (!(gaps <= (count > MACHINE_DOF ? 0.1 : 1e-10) * machine_size && machine_bounded(T, 12))) return 1;
    return in_mode ? 0 : 2;
}

static inline void machine_from_home(double *T, double *joints) {
    machine_pose(machine_home, T);
    for (int l = 0; l < MACHINE_LEGS; joints += machine_legs[l++].n_joints) machine_copy(machine_legs[l].home, joints, machine_legs[l].n_joints);
}

/* the pose of readings, and joints there, near a pose and joints or in the assembly mode of home: 0;
   1 if no pose closes all legs, 2 if it left the working or assembly mode of home, -1 for arguments
   without meaning */
static inline int machine_forward(const double *readings, const double *influences, const double *near_T, const double *near_joints, double *T, double *joints) {
    double known[MACHINE_INFLUENCES + 1], stage[MACHINE_READINGS], kept[12], kept_joints[MACHINE_JOINTS];
    int sound = machine_bounded(readings, MACHINE_READINGS) && machine_bounded(near_joints, MACHINE_JOINTS) && machine_known(influences);
    if (!sound || (near_T && !machine_rigid(near_T))) return -1;
    machine_know(influences, readings, known);
    machine_from_home(T, joints);
    if (near_T && near_joints) { machine_copy(near_T, T, 12); machine_copy(near_joints, joints, MACHINE_JOINTS); }
    int lost = machine_forward_at(readings, known, T, joints);
    if (!lost || near_T) return lost;
    machine_from_home(kept, kept_joints);
    for (int k = 1; k <= 10; k++) {
        for (int i = 0; i < MACHINE_READINGS; i++) stage[i] = machine_home_readings[i] + k / 10.0 * (readings[i] - machine_home_readings[i]);
        machine_copy(kept, T, 12); machine_copy(kept_joints, joints, MACHINE_JOINTS);
        lost = machine_forward_at(stage, known, T, joints);
        if (!lost) { machine_copy(T, kept, 12); machine_copy(joints, kept_joints, MACHINE_JOINTS); }
    }
    return lost;
}

/* the number of joints outside their limits */
static inline int machine_beyond_limits(const double *joints) {
    int count = 0;
    for (int l = 0; l < MACHINE_LEGS; joints += machine_legs[l++].n_joints) count += machine_outside(machine_legs + l, joints);
    return count;
}

#endif
