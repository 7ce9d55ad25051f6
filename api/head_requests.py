"""HEAD: every resource that can be read answers it as it answers GET, without the body (RFC 9110, 9.3.2)."""

from __future__ import annotations

from http import HTTPMethod

from starlette.types import ASGIApp, Message, Receive, Scope, Send


class _EndOfHeadersError(OSError):
    """The headers have been sent: what would follow, perhaps for ever, is not wanted."""


class HeadMiddleware:
    """ASGI middleware inside that of the request's context, so that log and measures keep the method that was asked."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer HEAD with the headers of GET; pass everything else on."""
        if scope["type"] != "http" or scope["method"] != HTTPMethod.HEAD:
            await self.app(scope, receive, send)
            return
        inner = {**scope, "method": HTTPMethod.GET.value}
        ended = False

        async def send_headers(message: Message) -> None:
            nonlocal ended
            if message["type"] == "http.response.start":
                await send(message)
            elif not ended:
                ended = True
                await send({"type": "http.response.body", "body": b"", "more_body": False})
            if ended and message.get("more_body", False):
                raise _EndOfHeadersError

        try:
            await self.app(inner, receive, send_headers)
        except _EndOfHeadersError:
            pass
        finally:
            if "route" in inner:
                scope["route"] = inner["route"]
