#include "store/workspace.h"

#include "base/panic.h"

workspace_content_t *workspace_take(workspace_t *workspace, workspace_user_t user) {
    REQUIRE(user != WORKSPACE_FREE && workspace->user == WORKSPACE_FREE);
    workspace->user = user;
    return &workspace->content;
}

void workspace_give_back(workspace_t *workspace, workspace_user_t user) {
    REQUIRE(user != WORKSPACE_FREE && workspace->user == user);
    workspace->user = WORKSPACE_FREE;
}
