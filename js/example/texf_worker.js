import '../src/service_worker.js';
