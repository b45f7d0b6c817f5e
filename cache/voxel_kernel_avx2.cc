#define PREHEAT_TRACE_VOXEL trace_voxel_avx2
#include "cache/voxel_kernel_body.h"
