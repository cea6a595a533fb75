// The contact layer between skin and tool, per area of the surface: its pressure grows with the depth d as
//     p = k d (1 + (d / h)^2),
// where k is its stiffness when it is hardly pressed, and h the depth at which the pressure is twice that of a linear
// layer; 0 stands for a linear layer. Form and h are assumed (docs/evidence/kernel.md). p is the slope of the energy, and the energy
// of the layer depends on its depth alone.
#pragma once

static inline double layer_pressure(double k, double h, double d) {
  double x = h > 0 ? d / h : 0;
  return h > 0 ? k * d * (1 + x * x) : k * d;
}

// The slope of the pressure [N/m^3].
static inline double layer_tangent(double k, double h, double d) {
  double x = h > 0 ? d / h : 0;
  return k * (1 + 3 * x * x);
}

// [J/m^2]
static inline double layer_energy(double k, double h, double d) {
  double x = h > 0 ? d / h : 0;
  return k * d * d * (0.5 + x * x / 4);
}
