// PPTAM_ASSERT: a condition that only our own bug can break. What happens then is set_assert_handler's; without
// PPTAM_ENABLE_ASSERT (Release) the expression is not evaluated.
#pragma once

#include <pocket_ptam/status.h>

#ifdef PPTAM_ENABLE_ASSERT
#define PPTAM_ASSERT(expression) \
  ((expression) ? (void)0 : ::pptam::detail::assert_handler()(#expression, __FILE__, __LINE__))
#else
#define PPTAM_ASSERT(expression) ((void)sizeof(!(expression)))
#endif
