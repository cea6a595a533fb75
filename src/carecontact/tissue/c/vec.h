// Three-vectors and rotations; every matrix is row-major, its columns are the axes of a frame.
#pragma once
#include <math.h>

static inline double dot(const double a[3], const double b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

// The C library's fmax and fmin are calls; these are one instruction each.
static inline double most(double a, double b) { return a > b ? a : b; }
static inline double least(double a, double b) { return a < b ? a : b; }
// Whether a number from a model or a state is one of the whole numbers 0 to n - 1 when its fraction is cut off.
static inline int counts(double x, double n) { return x >= 0 && x < n; }

static inline double most3(const double a[3]) { return most(fabs(a[0]), most(fabs(a[1]), fabs(a[2]))); }

static inline void cross(double out[3], const double a[3], const double b[3]) {
  out[0] = a[1] * b[2] - a[2] * b[1];
  out[1] = a[2] * b[0] - a[0] * b[2];
  out[2] = a[0] * b[1] - a[1] * b[0];
}

// out = R x
static inline void rotate(double out[3], const double R[9], const double x[3]) {
  for (int k = 0; k < 3; k++) out[k] = R[3 * k] * x[0] + R[3 * k + 1] * x[1] + R[3 * k + 2] * x[2];
}

// out = R^T x
static inline void rotate_back(double out[3], const double R[9], const double x[3]) {
  for (int k = 0; k < 3; k++) out[k] = R[k] * x[0] + R[3 + k] * x[1] + R[6 + k] * x[2];
}
