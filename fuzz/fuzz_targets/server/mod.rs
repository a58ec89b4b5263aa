//! The interface on a database in a temporary folder, asked without a network.

use axum::Router;
use axum::body::Body;
use axum::http::{Request, Response, header};
use http_body_util::BodyExt as _;
use std::sync::OnceLock;
use tokio::runtime::Runtime;
use tower::ServiceExt as _;
use volition::api::{AppState, Limits, router};
use volition::store::Store;

/// A server.
pub struct Server {
    runtime: Runtime,
    router: Router,
}

impl Server {
    /// The one server of this process.
    pub fn get() -> &'static Self {
        static SERVER: OnceLock<Server> = OnceLock::new();
        SERVER.get_or_init(|| {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
            let store = runtime.block_on(Store::open(None)).unwrap();
            let limits = Limits {
                max_body_bytes: 1 << 16,
                max_decompressed_bytes: 1 << 18,
                max_rows: 1000,
                max_multipart_files: 20,
                ..Limits::default()
            };
            let router = router(AppState::new(store).with_limits(limits));
            Server { runtime, router }
        })
    }

    /// Status and body of the answer.
    ///
    /// # Panics
    /// When the server says that it failed: whatever a client sends is no reason for that.
    pub fn ask(&self, method: &str, path: &str, content_type: &str, body: Vec<u8>) -> (u16, Vec<u8>) {
        let request = Request::builder().method(method).uri(path).header(header::HOST, "localhost");
        let request = request.header(header::CONTENT_TYPE, content_type).body(Body::from(body)).unwrap();
        let answer: Response<Body> = self.runtime.block_on(self.router.clone().oneshot(request)).unwrap();
        let status = answer.status().as_u16();
        let body = self.runtime.block_on(answer.into_body().collect()).unwrap().to_bytes().to_vec();
        assert!(status < 500, "{method} {path}: {status} {}", String::from_utf8_lossy(&body));
        (status, body)
    }
}
