// PPTAM_ASSERT checks a condition that only a bug of the core can break. On failure the handler of set_assert_handler()
// is called. Without PPTAM_ENABLE_ASSERT (Release) the expression is not evaluated.
#pragma once

#include <pocket_ptam/status.h>

#ifdef PPTAM_ENABLE_ASSERT
#define PPTAM_ASSERT(expression) \
  ((expression) ? (void)0 : ::pptam::detail::assert_handler()(#expression, __FILE__, __LINE__))
#else
#define PPTAM_ASSERT(expression) ((void)sizeof(!(expression)))
#endif
