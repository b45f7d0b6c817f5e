#define PREHEAT_TRACE_VOXEL trace_voxel_sse42
#include "cache/voxel_kernel_body.h"
