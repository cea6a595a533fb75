// EXPORT before a function lets Python call it; all others stay inside the library.
#pragma once
#define EXPORT __attribute__((visibility("default")))
